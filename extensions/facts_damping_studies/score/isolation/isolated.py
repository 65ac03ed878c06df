from contextlib import contextmanager
from typing import NamedTuple
class Child(NamedTuple):
    name: str; computing: float; slowest_s: float; breach: str; read: tuple = (); plant: bool = False
@contextmanager
def isolated(case, seed):
    yield case, []
def breach_of(error): return ""
