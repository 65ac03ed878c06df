"""The package as colcon installs it: what `ros2 run` and `ros2 launch` look for, and where."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import facts_damping
from tests.passed import inputs

# Of the package's modules it matters here which there are: that they load is seen by all other tests.
pytestmark = inputs(
    contents=["*.toml", "*.py", "*.cfg", "*.xml", "*.pkg", "Makefile", "facts_damping/version.py"]
    + [f"{part}/**/*" for part in ("msg_defs", "ros_package", "launch", "resource")],
    names=["facts_damping/**/*", "extensions/**/*", "config/**/*"],
)

ROOT = Path(__file__).parents[1]
PARTS = ["facts_damping", "extensions", "msg_defs", "ros_package", "config", "launch", "resource"]
FILES = ["package.xml", "setup.py", "setup.cfg", "pyproject.toml", "colcon.pkg"]
EXECUTABLES = [
    "c37118_client",
    "c37118_server",
    "cockpit",
    "controller",
    "facts-damping",
    "identifier",
    "live_view",
    "plant_sim",
    "recorder",
    "supervisor",
    "wan_link",
]
PACKAGES = ["facts_damping", "facts_damping_msgs"]
# Interfaces that colcon builds here: most of its time is the compiler's. All of them are built when pip installs them.
FEW = {"msg/PmuDataFrame.msg", "msg/PmuFrame.msg", "srv/Step.srv"}


def files(folder: Path) -> set[str]:
    """List all files below a folder, relative to it."""
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and p.suffix != ".pyc"}


@pytest.fixture(scope="module")
def install(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install space of a plain `colcon build` in a workspace that has a copy of the repository below `src`."""
    workspace = tmp_path_factory.mktemp("workspace")
    source = workspace / "src" / "facts_damping"
    source.mkdir(parents=True)
    for part in PARTS:
        shutil.copytree(ROOT / part, source / part, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(ROOT / name, source)
    for interface in files(source / "msg_defs") - FEW:
        if interface.endswith((".msg", ".srv")):
            (source / "msg_defs" / interface).unlink()
    # Unoptimised: what is built is looked at, and not for long.
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "CFLAGS": "-O0", "CXXFLAGS": "-O0"}

    def colcon(*arguments: str) -> str:
        command = [sys.executable, "-m", "colcon", *arguments]
        done = subprocess.run(command, cwd=workspace, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    listed = [line.split()[0] for line in colcon("list", "--topological-order").splitlines()]
    assert listed == ["facts_damping_msgs", "facts_damping"]
    colcon("build")
    return workspace / "install"


def run_installed(install: Path, script: str, code: str) -> str:
    """Run Python with a script of the install space sourced, away from the checkout; return what it prints."""
    done = subprocess.run(
        ["bash", "-c", '. "$0" && exec "$1" -c "$2"', install / script, sys.executable, code],
        cwd=install,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("name", EXECUTABLES)
def test_executable_is_where_ros2_run_looks(install: Path, name: str) -> None:
    executable = install / "facts_damping" / "lib" / "facts_damping" / name
    assert os.access(executable, os.X_OK)


@pytest.mark.parametrize("package", PACKAGES)
def test_package_is_in_the_ament_index(install: Path, package: str) -> None:
    share = install / package / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / package).is_file()
    assert (share / package / "package.xml").is_file()


@pytest.mark.parametrize("folder", ["config", "launch"])
def test_data_files_are_all_installed(install: Path, folder: str) -> None:
    assert files(install / "facts_damping" / "share" / "facts_damping" / folder) == files(ROOT / folder)


def test_message_definitions_are_installed_verbatim(install: Path) -> None:
    installed = install / "facts_damping_msgs" / "share" / "facts_damping_msgs"
    for source in FEW:
        assert (installed / source).read_bytes() == (ROOT / "msg_defs" / source).read_bytes()


def test_entry_points_load_from_the_install_space(install: Path) -> None:
    code = """
from importlib.metadata import distribution
import sys
for point in distribution("facts_damping").entry_points:
    found = point.load()
    module = getattr(found, "__module__", getattr(found, "__name__", point.module))
    print(point.group, point.name, sys.modules[module].__file__)
"""
    output = run_installed(install, "facts_damping/share/facts_damping/package.bash", code)  # its own paths alone
    rows = [line.split() for line in output.splitlines()]
    assert sorted(name for group, name, _ in rows if group == "console_scripts") == EXECUTABLES
    assert all(Path(path).is_relative_to(install) for *_, path in rows), rows


def test_messages_load_from_the_install_space(install: Path) -> None:
    code = """
from facts_damping_msgs import msg
from rclpy.serialization import deserialize_message, serialize_message
sent = msg.PmuDataFrame(tick=7, fresh=True, frames=[msg.PmuFrame()])
assert deserialize_message(serialize_message(sent), msg.PmuDataFrame) == sent
print(msg.__file__)
"""
    assert Path(run_installed(install, "setup.bash", code)).is_relative_to(install)


def test_package_version_is_the_same_everywhere() -> None:
    version = facts_damping.__version__
    for path in (ROOT / "package.xml", ROOT / "msg_defs" / "package.xml"):
        assert f"<version>{version}</version>" in path.read_text()
    assert re.search(rf'^version = "{version}"$', (ROOT / "msg_defs" / "pyproject.toml").read_text(), re.MULTILINE)


def test_make_offers_the_distributions_of_ros_that_there_are_wheels_of() -> None:
    wheels = re.findall(r'^    "(\w+)": {$', (ROOT / "setup.py").read_text(), re.MULTILINE)
    names = re.findall(r"ROS=.*: there are wheels of (.*?)\"", (ROOT / "Makefile").read_text())
    assert names == [" and ".join(wheels)]


def test_tables_and_pages_of_the_package_are_installed(install: Path) -> None:
    """Commands of core and wings, sentences of reports, pages of the cockpit."""
    code = """
from pathlib import Path
from facts_damping.cli.parser import parser
from facts_damping_views.report.contents import SENTENCES
import facts_damping_views.cockpit as cockpit
commands = next(action.choices for action in parser()._actions if action.choices)
static = Path(cockpit.__file__).with_name("static")
print(len(commands), len(SENTENCES), len(list(static.iterdir())), Path(cockpit.__file__))
"""
    words = run_installed(install, "facts_damping/share/facts_damping/package.bash", code).split()
    assert Path(words[3]).is_relative_to(install)
    assert int(words[0]) >= 22
    assert int(words[1]) > 20
    assert int(words[2]) > 3
