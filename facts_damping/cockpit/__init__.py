"""The cockpit: one page in a browser that shows a run and changes it. Nothing here knows ROS (nodes/cockpit.py does)."""
