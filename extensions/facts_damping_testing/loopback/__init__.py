"""A graph in one process, without DDS: nodes are threads that take turns, and time goes on when all of them wait.

The code of nodes and the Python code of rclpy run unchanged. Replaced are rclpy's C++ part (`implementation`) and what
belongs to a process: arguments, outputs, clock, signals (`processes`). Messages are the bytes that DDS would carry.
Everything happens in a fixed order, so a run repeats itself.
"""
