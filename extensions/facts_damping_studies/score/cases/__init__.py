"""Sets of cases for scores: drawn from a text, so that a held-out set can be drawn from a secret one."""
