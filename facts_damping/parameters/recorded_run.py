"""The run that a recording holds: complete, so nothing in it names what stands elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.parameters.events import Scenario
from facts_damping.parameters.field_errors import FieldError, check_field, short, worded
from facts_damping.parameters.link import Link
from facts_damping.parameters.measurement import Measurement
from facts_damping.parameters.plant.system import System
from facts_damping.parameters.run import Run
from facts_damping.parameters.supervision import Supervision

if TYPE_CHECKING:
    from facts_damping.fields import ParameterModel

TABLES: dict[str, type[ParameterModel]] = {
    "system": System,
    "model": System,
    "link": Link,
    "measurement": Measurement,
    "supervision": Supervision,
}  # fields whose content a recorded run has inline, where a run file may name it


def recorded_run(content: Any, source: str) -> dict[str, Any]:
    """The fields of a recorded run, with the content of all tables checked and complete.

    A field that the content lacks stays out, apart from `system`, which it needs. Raises `InputError` in one line:
    source, field, value, what is allowed.
    """
    with worded(source):
        run = check_field(Run, content, "")
        check_field(Run, run.asked or {}, "asked")
        if "system" not in content:
            raise FieldError("system", "missing; allowed: the content of a system")
        fields = run.model_dump(include=set(content))
        for name in TABLES.keys() & content.keys():
            fields[name] = _table(TABLES[name], getattr(run, name), name)
        if "scenario" in content:
            events = check_field(Scenario, {"name": "recorded", "events": run.scenario}, "scenario").events
            fields["scenario"] = [event.model_dump() for event in events]
        for i, row in enumerate(fields.get("controllers", [])):
            row["link"] = _table(Link, row["link"], f"controllers.{i}.link")
    return fields


def _table(model: type[ParameterModel], content: Any, field: str) -> dict[str, Any] | None:
    """Content of a field as its model has it. Raises `FieldError`, also for the name of a file or of a shipped one."""
    if content is None:
        return None
    if not isinstance(content, dict):
        raise FieldError(field, f"{short(content)} given; allowed: its content")
    return check_field(model, content, field).model_dump(by_alias=True)
