"""Tests of the node of one's own (docs/extensions.md): pytest examples/test_lead_lag_node.py."""

import pytest
from lead_lag_node import main

import facts_damping as fd
from facts_damping.testing import loopback  # noqa: F401 (a fixture)

RUN = {"scenario": "large", "link": "pdci", "watchdog": "off", "duration": 3}


MINE = [{"name": "mine", "external": True}]


@pytest.fixture
def graph(loopback):  # noqa: F811
    loopback.start("mine", main, ["--ros-args", "-r", "__node:=controller_0_mine"])
    return loopback


def test_lead_lag_node_gives_the_bits_of_the_shipped_lead_lag(graph, tmp_path):
    recorded = graph.run(None, tmp_path / "run", controllers=MINE, **RUN)
    shipped = fd.simulate(controllers=[{"name": "LLC"}], **RUN)
    assert recorded.issued["value"].tobytes() == shipped.issued["value"].tobytes()


def test_lead_lag_node_serves_a_graph_in_real_time(graph, tmp_path):
    recorded = graph.run(None, tmp_path / "run", "realtime", controllers=MINE, **RUN)
    assert recorded.in_synchronism.all()
