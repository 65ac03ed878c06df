"""Graphs of processes: started, watched, faulted, ended."""
