"""EXDC1: the name that GridPACK gives to the record of IEEEX1; the same equations (GridPACK, `exdc1.cpp`)."""

from __future__ import annotations

from facts_damping_library.exciters import ieeex1

ROW = ieeex1.ROW
