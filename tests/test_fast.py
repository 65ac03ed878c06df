"""What `make test-fast` chooses."""

from tests.budgets import Cost
from tests.fast import chosen

FILES = {
    "tests/plant/test_ports.py": Cost(4.0, 10),
    "tests/plant/test_sssc.py": Cost(5.0, 10),
    "tests/link/test_models.py": Cost(10.0, 50),
    "tests/link/test_transfer.py": Cost(8.0, 10),
    "tests/nodes/test_kills.py": Cost(40.0, 5),
}


def test_tests_of_a_changed_file_come_first_then_those_of_its_folder() -> None:
    changed = ["facts_damping/plant/ports.py"]
    assert chosen(FILES, changed, 4.0) == {"tests/plant/test_ports.py"}
    assert chosen(FILES, changed, 9.0) == {"tests/plant/test_ports.py", "tests/plant/test_sssc.py"}


def test_tests_of_a_wing_follow_its_files() -> None:
    changed = ["extensions/facts_damping_link/chain.py"]
    assert chosen(FILES, changed, 18.0) == {"tests/link/test_models.py", "tests/link/test_transfer.py"}
    assert chosen(FILES, ["extensions/facts_damping_views/nodes/view.py"], 40.0) == {"tests/nodes/test_kills.py"}


def test_then_come_those_of_which_a_second_buys_most() -> None:
    assert chosen(FILES, [], 10.0) == {"tests/link/test_models.py"}
    assert chosen(FILES, ["README.md"], 67.0) == set(FILES)
    assert chosen(FILES, ["README.md"], 66.0) == set(FILES) - {"tests/nodes/test_kills.py"}


def test_changed_test_is_run_whatever_it_costs() -> None:
    assert chosen(FILES, ["tests/nodes/test_kills.py"], 1.0) == {"tests/nodes/test_kills.py"}
