"""Two areas of PSTess with inverters: all comparisons."""

from __future__ import annotations

from facts_damping_validation import grid_following, grid_forming
from facts_damping_validation.pstess import SOURCE_TEXT
from facts_damping_validation.table import ValidationTable


def eigenvalues() -> ValidationTable:
    """Eigenvalues with grid-forming and with grid-following inverters."""
    rows = [*grid_forming.eigenvalues(), *grid_following.eigenvalues()]
    return ValidationTable("Eigenvalues of two areas with inverters", SOURCE_TEXT, "", rows)


def disturbances() -> ValidationTable:
    """Speeds, voltages, powers and currents after a disturbance, relative to the range of each."""
    rows = [*grid_forming.disturbances(), *grid_following.disturbances()]
    return ValidationTable("Disturbances of two areas with inverters", SOURCE_TEXT, "", rows)
