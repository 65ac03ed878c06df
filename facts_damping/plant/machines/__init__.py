"""Synchronous machines and their controls: circuits, exciters, governors, stabilisers, tables of blocks."""
