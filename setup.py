"""Package metadata, for pip and colcon alike.

It is here and not in a [project] table of pyproject.toml because colcon reads setup.py only.
"""

import re
from pathlib import Path

from setuptools import Distribution, find_packages, setup

ROOT = Path(__file__).parent
NAME = "facts_damping"
NODES = (
    *("plant_sim", "wan_link", "controller"),
    *("identifier", "supervisor", "recorder"),
)
NODES_OF = {"streams": ("c37118_server", "c37118_client"), "views": ("cockpit", "live_view")}  # of WINGS
# Packages beside the core, which finds what they add by entry points, as it finds that of other distributions.
WINGS = {
    wing: f"{NAME}_{wing}"
    for wing in ("grids", "gym", "library", "streams", "studies", "testing", "validation", "views")
}
DEVICES = ("bess", "csvgn1", "exciter_input", "inverter_input", "svc", "tcsc")  # kinds that the library adds

# Wheels of ROS 2 by distribution: what runs, then what builds msg_defs, of which several are needed by others without
# being declared there. They install modules of the same names, so an environment holds one distribution.
ROS = {
    "kilted": {
        "diagnostic-msgs": "5.5.1",
        "rclpy": "9.1.2",
        "rmw-fastrtps-cpp": "9.3.3",
        "std-msgs": "5.5.1",
        "std-srvs": "5.5.1",
        "ament-cmake": "2.7.3",
        "ament-cmake-include-directories": "2.7.3",
        "ament-cmake-ros-core": "0.14.5",
        "ament-package": "0.17.2",
        "rosidl-core-generators": "0.3.1",
        "rosidl-default-generators": "1.7.1",
    },
    "jazzy": {
        "diagnostic-msgs": "5.3.6",
        "rclpy": "7.1.6",
        "rmw-fastrtps-cpp": "8.4.3",
        "std-msgs": "5.3.6",
        "std-srvs": "5.3.6",
        "ament-cmake": "2.5.4",
        "ament-cmake-gmock": "2.5.4",
        "ament-cmake-gtest": "2.5.4",
        "ament-cmake-include-directories": "2.5.4",
        "ament-cmake-pytest": "2.5.4",
        "ament-cmake-ros": "0.12.0",
        "ament-package": "0.16.4",
        "python-cmake-module": "0.11.1",
        "rosidl-core-generators": "0.2.0",
        "rosidl-default-generators": "1.6.0",
    },
}
DEFAULT_ROS = "kilted"


def ros(distribution: str) -> list[str]:
    """What pip installs for a distribution of ROS 2, with the tools that build messages for it."""
    wheels = [f"ros-{distribution}-{name}=={version}" for name, version in ROS[distribution].items()]
    return [*wheels, "catkin-pkg>=1,<2", "cmake>=3.24,<5", "ninja>=1.11,<2", "scikit-build-core>=0.10,<2"]


def version() -> str:
    """Return `__version__` of the package, without importing it."""
    match = re.search(r'^__version__ = "(.+)"$', (ROOT / NAME / "version.py").read_text(), re.MULTILINE)
    if match is None:
        raise ValueError(f"{NAME}/version.py: no line __version__ = ...")
    return match[1]


def shared(*folders: str) -> list[tuple[str, list[str]]]:
    """List the files below the folders for share/facts_damping, each in its own folder."""
    found: dict[str, list[str]] = {}
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                relative = path.relative_to(ROOT)
                found.setdefault(f"share/{NAME}/{relative.parent.as_posix()}", []).append(relative.as_posix())
    return list(found.items())


class Platform(Distribution):  # type: ignore[misc]
    """A wheel with compiled kernels in it is one for this Python and this processor."""

    def has_ext_modules(self) -> bool:
        """Whether there are any."""
        return any((ROOT / NAME / "compiling" / "objects").glob("*.o"))


DOCS = [  # for `mkdocs serve`
    "mkdocs>=1.6,<2",
    "mkdocs-jupyter>=0.25,<1",
    "mkdocs-material>=9.6,<10",
    "mkdocs-redirects==1.2.2",  # later ones bring a fork of mkdocs
    "mkdocstrings[python]>=0.29,<2",
]

COCKPIT = [  # for the node and the command `cockpit`
    "starlette>=0.46,<2",
    "uvicorn>=0.35,<1",  # before, not with websockets' own protocol
    "websockets>=14,<18",
]

setup(
    distclass=Platform,
    name=NAME,
    version=version(),
    description="Wide-area damping of power systems with FACTS devices, as a ROS 2 node graph.",
    license="Apache-2.0",
    maintainer="facts_damping maintainers",
    maintainer_email="maintainers@example.org",
    python_requires=">=3.10",
    packages=[*find_packages(include=[NAME, f"{NAME}.*"]), *find_packages("extensions")],
    package_dir={wing: f"extensions/{wing}" for wing in WINGS.values()},
    package_data={
        "": ["py.typed", "commands.yaml"],
        NAME: ["templates/*/*.txt"],
        f"{NAME}.compiling": ["objects/*.o"],  # where `make wheel` has put them
        f"{NAME}.nodes": ["fast*.xml"],
        f"{WINGS['views']}.cockpit": ["static/*", "static/*/*"],
        f"{WINGS['views']}.report": ["page.*", "sentences.yaml"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared("cards", "config", "launch"),
    ],
    zip_safe=False,
    # Lower bounds: what runs on Python 3.10. Upper bounds: the next release that may break.
    install_requires=[
        "argcomplete>=3,<4",
        "cmaes>=0.11,<0.14",
        "control>=0.10.1,<0.11",  # before, its ERA was not there
        "bokeh>=3.6,<4",  # analyze --report
        "jinja2>=3.1,<4",
        "joblib>=1.5,<2",  # which hands an initializer to its processes
        "matplotlib>=3.8,<4",
        "lz4>=4,<5",
        "mcap>=1.5,<2",
        "networkx>=3.2,<4",  # one-line diagrams: where buses stand
        "numba>=0.60,<1",
        "numpy>=1.26,<2.5",  # the type information of 2.5 rejects a plain array.max()
        "pyarrow>=17",  # no upper bound: a major release a quarter, and only tables are written
        "pydantic>=2.6,<3",
        "pyyaml>=6,<7",
        "rosbags>=0.10,<1",
        "scipy>=1.15,<2",
        "setproctitle>=1.3,<2",
        "threadpoolctl>=3,<4",
        "zstandard>=0.22,<1",
    ],
    extras_require={
        # ROS 2 from wheels; not for an environment that has ROS 2 from apt.
        "ros": ros(DEFAULT_ROS),
        **{f"ros-{distribution}": ros(distribution) for distribution in ROS},
        "fmi": ["fmpy==0.3.22"],  # FMUs as controllers; later ones bring CMake and Jupyter along
        "cockpit": COCKPIT,
        "foxglove": ["foxglove-sdk>=0.30,<1"],  # for the node live_view
        "dask": ["distributed>=2024.1"],  # for `facts-damping sweep --scheduler`; versions are dates
        "gymnasium": ["gymnasium>=1.0,<2"],  # for the environment
        "pandas": ["pandas<4"],  # for `to_pandas`
        "matpower": ["matpowercaseframes==2.1.1", "pandas<4"],  # for `facts-damping import`
        "docs": DOCS,
        "test": [
            *DOCS,
            *COCKPIT,
            "colcon-common-extensions>=0.3,<1",  # tests/test_packaging.py
            "distributed>=2024.1",
            "fmpy==0.3.22",
            "foxglove-sdk>=0.30,<1",
            "grimp>=3,<4",  # docs/drawing.py; import-linter brings it along
            "gymnasium>=1.0,<2",
            "hypothesis>=6.100,<7",
            "import-linter>=2,<3",
            "matpowercaseframes==2.1.1",
            "pandas<4",
            "mpmath>=1.3,<2",  # tests/test_elementary.py
            "playwright>=1.50,<2",  # drives Debian's Chromium, brings no browser of its own
            "mypy==2.4.1",  # exact, as ruff: a new release finds new faults
            "pytest>=8,<9.2",  # from there on pytest-xdist 3.8 knows no groups
            "pytest-cov>=7,<8",
            "pytest-timeout>=2.3,<3",
            "pytest-xdist>=3.6,<4",
            "pythonfmu==0.7.0",
            "pythonfmu3==0.3.4",
            "ruff==0.17.5",
            "synchrophasor==1.0.0a0",  # another program's frames, tests/streams/c37118
            "types-PyYAML>=6,<7",
            "types-networkx>=3.2,<4",
            "httpx>=0.27,<1",  # starlette's test client
        ],
    },
    entry_points={
        "console_scripts": [
            f"facts-damping = {NAME}.cli.main:main",
            *(f"{node} = {NAME}.nodes.executables:{node}" for node in NODES),
            *(f"{node} = {WINGS[wing]}.executables:{node}" for wing, nodes in NODES_OF.items() for node in nodes),
        ],
        f"{NAME}.commands": [
            f"{wing} = {package}" for wing, package in WINGS.items() if wing not in ("gym", "library")
        ],
        f"{NAME}.nodes": [
            f"attacker = {WINGS['testing']}.attacker",
            *(f"{node} = {WINGS[wing]}.nodes.{node}" for wing, nodes in NODES_OF.items() for node in nodes),
        ],
        f"{NAME}.api": [
            *(f"{name} = {WINGS['studies']}.api.scores:{name}" for name in ("Score", "score")),
            *(f"{name} = {WINGS['studies']}.api.sweeps:{name}" for name in ("Sweep", "sweep")),
        ],
        f"{NAME}.modules": [f"environment = {WINGS['gym']}", f"testing = {WINGS['testing']}.fixtures"],
        f"{NAME}.device_kinds": [f"{kind} = {WINGS['library']}.devices.{kind}:ROW" for kind in DEVICES],
        f"{NAME}.kernels": [f"gym = {WINGS['gym']}.many"],
        f"{NAME}.machine_controls": [f"library = {WINGS['library']}:MODELS"],
        f"{NAME}.exports": [f"m = {WINGS['grids']}.matpower_writing:export"],
    },
)
