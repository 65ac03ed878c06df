"""Neuro-fuzzy networks: antecedents and consequents as tables, forward pass and gradients; compiled."""
