"""Exciters, governors and stabilisers as rows: diagram of blocks, parameters with units, limits (docs/machines.md)."""
