"""Storms: graphs of the nodes on a loopback, in which everything random, faults included, comes from one seed.

A storm is drawn (`drawing`), run (`running`) and judged by rules (`rules`). A seed that breaks a rule is shrunk to the
fewest events (`shrinking`). Many storms are run, and those that reach something new are varied (`search`).
"""
