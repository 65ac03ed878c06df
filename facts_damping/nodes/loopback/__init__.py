"""A graph in one process, without DDS: nodes are threads that take turns, and time goes on when all of them wait.

Nodes' own code and rclpy's run as they are. What rclpy has in C++ is replaced: topics, services, timers, wait sets
(`middleware`), and what a process has of its own: its arguments, its outputs, its clock, its signals (`processes`).
Messages are the bytes that DDS would carry. Everything is in a fixed order, so a run repeats itself.
"""
