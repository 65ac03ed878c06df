"""What systems, scenarios, links and runs consist of: plain data with units, meanings and ranges."""
