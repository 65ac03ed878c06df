"""Controllers that are programs of the user's own: classes, functions, FMUs."""
