"""Controllers that hold in all scenarios of a grid: scenarios, structures, tuning, certificate."""
