"""`DeviceKind` of `facts_damping.devices.kind`, where earlier pages have it."""

from facts_damping.devices.kind import DeviceKind as DeviceKind
