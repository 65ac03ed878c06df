"""The Pacific DC Intertie's damping control: the study behind docs/pdci.md."""
