"""Neuro-fuzzy networks: tables of antecedents and consequents, forward pass, gradients, learning; compiled."""
