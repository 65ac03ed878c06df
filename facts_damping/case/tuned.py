"""Tuned parameters: files of rows that `tune` or `search` has chosen, and the names of their laws, `KIND@FILE`."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from facts_damping.control.table import kind, kind_name
from facts_damping.parameters import files
from facts_damping.parameters.field_errors import FieldError, check, check_known
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Controller, Tuned, TunedController

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Laws = dict[tuple[str, str | None], TunedController]  # by kind and scheme; each row has its law's name


def tuned(
    system: str,
    signals: list[str] | None = None,
    devices: list[str] | None = None,
    measurement: str = "ideal",
    profile: str = DEFAULT_PROFILE,
    compensation: str = "none",
) -> Laws:
    """Tuned laws for a system and profile.

    They hold only for the signals and devices they were tuned with (default: those of a run); a lead-lag uses the first
    signal. Parameters tuned with the same `measurement` take precedence over those of exact signals, those tuned with
    the same `compensation` over those without.
    """
    usual = Controller()
    signals, devices = signals or usual.signals, devices or usual.devices
    measured = ("ideal", "p_class", "m_class") if files.is_path(profile) else ("ideal", measurement)
    fitting = [(file, table) for file, table in chosen(system, profile).items() if table.measurement in measured]
    laws: Laws = {}
    for wanted in dict.fromkeys(("none", compensation)):
        for file, table in sorted(fitting, key=lambda pair: pair[1].measurement == measurement):
            for name, row in rows(file, table):
                fits = table.devices == devices and row.compensation == wanted
                if fits and _signals(table, row) == signals:
                    laws[row.name, row.scheme] = row.model_copy(update={"name": name if file else row.name})
    return laws


def rows(file: str, table: Tuned) -> Iterator[tuple[str, TunedController]]:
    """The rows of a file with their laws' names: `KIND@FILE`, or `KIND@FILE.ROW` if the row has a name of its own."""
    return ((f"{row.name}@{file}{f'.{row.row}' if row.row else ''}", row) for row in table.controllers)


def chosen(system: str, profile: str) -> dict[str, Tuned]:
    """Files of tuned parameters for a system and profile by name: `<system>_<profile>...`, or the one of a path.

    The default profile's name is left out, and that of a path: it names no law.
    """
    if files.is_path(profile):
        file = check(Tuned, files.read_table(files.find("controllers", profile)), profile)
        if file.system != system:
            raise FieldError("tuning", f"parameters for {file.system} given; allowed: those for {system}")
        return {"": file}
    begins = system if profile == DEFAULT_PROFILE else f"{system}_{profile}"
    tables = {name: read(file) for name, file in files.shipped("controllers").items() if name.startswith(begins)}
    return {name: file for name, file in tables.items() if (file.system, file.profile) == (system, profile)}


def law(controller: Controller, system: str, field: str) -> Laws:
    """The law that a controller's whole name is of; without a scheme, that of each. None for the name of a kind.

    A stored run has all parameters, so its file need not be there. Raises `FieldError` for a name that
    no row has, and for another system, other signals, devices or compensation than the row's.
    """
    _, at, file = controller.name.partition("@")
    file = file.partition(".")[0]
    if not at or (controller.parameters and file not in files.shipped("controllers")):
        return {}
    table = read(files.find("controllers", file))
    named = [(name, row) for name, row in rows(file, table) if controller.scheme in (None, row.scheme)]
    check_known(field, controller.name, list(dict.fromkeys(name for name, _ in named)))
    laws: Laws = {}
    for row in (row for name, row in named if name == controller.name):
        wanted = [table.system, ",".join(_signals(table, row)), ",".join(table.devices), row.compensation]
        here = [system, ",".join(controller.signals), ",".join(controller.devices), controller.compensation]
        if here != wanted:
            problem = f"'{controller.name}' given for {', '.join(here)}"
            raise FieldError(field, f"{problem}; allowed: {', '.join(wanted)}, or {kind_name(controller.name)}")
        laws[row.name, row.scheme] = row.model_copy(update={"name": controller.name})
    return laws


def _signals(table: Tuned, row: TunedController) -> list[str]:
    return table.signals if row.policy else table.signals[: kind(row.name).signals]


@cache
def read(path: Path) -> Tuned:
    """A file of tuned parameters."""
    return check(Tuned, files.read_table(path), str(path))
