"""The cockpit: one page in a browser that shows a run and changes it; its node is nodes/cockpit.py."""
