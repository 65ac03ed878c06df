"""All kinds of devices by name: the next one is a file here and a row of this table."""

from __future__ import annotations

from facts_damping.devices import hvdc, load_modulation, sssc, statcom
from facts_damping.devices.base import DeviceModel
from facts_damping.devices.kind import DeviceKind
from facts_damping.errors import InputError
from facts_damping.extensions import rows

KINDS: dict[str, DeviceKind] = {
    "sssc": sssc.ROW,
    "statcom": statcom.ROW,
    "hvdc": hvdc.ROW,
    "load_modulation": load_modulation.ROW,
}
KINDS |= rows("device_kinds", DeviceKind, KINDS)
MODELS = {name: kind.model for name, kind in KINDS.items() if kind.model} | rows("devices", DeviceModel)
if KINDS.keys() != MODELS.keys():
    raise InputError(f"devices: {', '.join(KINDS.keys() - MODELS)} given without fields; allowed: with `model`")
