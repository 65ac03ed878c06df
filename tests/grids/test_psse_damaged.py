"""Numbers in PSS/E files of which no equation can be made: each is one line of an error, whatever it would lead to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from facts_damping.errors import InputError
from facts_damping_grids.psse.conversion import import_case
from tests.grids.test_psse import DYR, RAW, TRANSFORMER, raw_with
from tests.grids.test_psse_files import as_23

if TYPE_CHECKING:
    from pathlib import Path

DC = "'DC',1,6.2,1e9,460,300,0.1,0.1\n4,4,20,15,0,6.8,230,0.7476,1\n6,4,18,20,0,6.8,230,0.7476,1\n0 / END OF TWO"
THIRD = "2,7,8,'1 ',1,1,1,0,0,2,'T',half,1,1\n0,0.06,100,0,0.1,100,0,0.09,100,1,0\n1,0,0,\\1\n1,0,0,0\n1,0,0,0"
GAST = "2 'GAST' 1 0.05 0.4 0.1 3 1 -1 1 0 0 /\n"
PSS2B = "2 'PSS2B' 1 1 0 3 0 1000000 5 2 2 0 2 0 2 0.5 1 0.5 0.1 20 0.1 0.02 0.1 0.02 0 0 9 -9 9 -9 9 -9 /\n"


def refused(folder: Path, raw: str, dyr: str) -> list[str]:
    """The lines of the error with which a case is refused."""
    (folder / "case.raw").write_text(raw, encoding="utf-8")
    (folder / "case.dyr").write_text(dyr, encoding="utf-8")
    with pytest.raises(InputError) as error:
        import_case(folder / "case.raw", folder / "case.dyr")
    return [line.rpartition("/case")[2] for line in str(error.value).splitlines()]


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("9.55 0 1.8 1.7", "9.55 0 1.8 1e20", ".dyr: line 2: GENROU: of G1: circuits without a steady state given"),
        ("2 'TGOV1'", f"{GAST}9 'TGOV1'", ".dyr: line 9: GAST: of G2: an infinite gain given; allowed: finite gains"),
        ("2 'ST2CUT'", f"{PSS2B}9 'ST2CUT'", ".dyr: line 10: PSS2B: of G2: M N = 5e+06 given; allowed: at most 20"),
    ],
)
def test_constants_of_which_no_circuits_or_blocks_are_made(before: str, after: str, said: str, tmp_path: Path) -> None:
    assert before in DYR.read_text()
    (line,) = refused(tmp_path, RAW.read_text(), DYR.read_text().replace(before, after, 1))
    assert line.startswith(said)


def test_converters_carry_no_power_below_a_voltage_of_zero(tmp_path: Path) -> None:
    (line,) = refused(tmp_path, raw_with(("^0 / END OF TWO", DC)), DYR.read_text())
    assert line == ".raw: line 44: two-terminal dc: SETVL = 1e+09 given; allowed: a power that VSCHD and RDC can carry"


def test_status_of_three_windings_that_is_no_number(tmp_path: Path) -> None:
    assert refused(tmp_path, raw_with((TRANSFORMER, THIRD)), DYR.read_text()) == [
        ".raw: line 34: transformer: STAT: 'half' given; allowed: a number"
    ]


def test_ratio_of_version_23_whose_square_vanishes(tmp_path: Path) -> None:
    text = as_23(RAW.read_text()).replace("1,-4,'T ',0,0.0576,0,0,0,0,1,0", "1,-4,'T ',0,0.0576,0.2,0,0,0,1e-300,5")
    assert any("given; allowed: " in line for line in refused(tmp_path, text, DYR.read_text()))
