"""Elementary functions whose bits no processor chooses: sums, products, quotients and square roots of floats alone.

The C library, behind `math`, has other functions for processors that multiply and add in one step. These are the same
in compiled code on every processor, and in Python (`sin.py_func`). They are as exact and about as fast.
"""

from facts_damping.elementary.angle import atan2, exp_complex, hypot, magnitude, phase, rect
from facts_damping.elementary.circular import cos, sin, sin_cos, tan
from facts_damping.elementary.exponential import exp, expm1, tanh
from facts_damping.elementary.logarithm import log, log1p, power

__all__ = [
    "atan2",
    "cos",
    "exp",
    "exp_complex",
    "expm1",
    "hypot",
    "log",
    "log1p",
    "magnitude",
    "phase",
    "power",
    "rect",
    "sin",
    "sin_cos",
    "tan",
    "tanh",
]
