"""A score for any controller: a frozen set of cases, and a card of what came out."""
