"""The RTDE server by the published protocol, without Universal Robots' or anybody's library."""

import asyncio
import json
import struct

import pytest

from rigsim.log import EventLog
from rigsim.robot import Controller
from rigsim.ur import RTDE_PORT, RtdeServer
from rigsim_process import CENTRE, free_host, in_background
from rtde_client import RtdeClient

RULES = {
    "max_speed_m_s": None,
    "max_acceleration_m_s2": None,
    "box_m": None,
    "watchdog": False,
    "asynchronous": False,
}


class Served:
    """A controller's RTDE port in this process."""

    def __init__(self, series: str, folder):
        self.log = EventLog(folder / "events.jsonl")
        self.robot = Controller(series, CENTRE, 1.0, RULES, self.log)
        self.server = RtdeServer(self.robot, self.log)
        self.host = free_host()

    async def listen(self) -> None:
        await asyncio.start_server(self.server.serve, self.host, RTDE_PORT)

    def violations(self) -> list[str]:
        entries = map(json.loads, self.log.path.read_text(encoding="utf-8").splitlines())
        return [e["reason"] for e in entries if e["event"] == "violation"]


@pytest.fixture(params=["cb3", "e"])
def served(request, tmp_path):
    served = Served(request.param, tmp_path)
    with in_background() as loop:
        asyncio.run_coroutine_threadsafe(served.listen(), loop).result()
        yield served


@pytest.fixture
def client(served):
    client = RtdeClient(served.host)
    assert client.ask("V", struct.pack(">H", 2)) == b"\x01"
    yield client
    client.close()


def test_the_version_and_the_pose_come_as_the_protocol_says(served, client):
    version = struct.unpack(">4I", client.ask("v"))
    assert version == served.robot.series.version
    assert (
        version[:2]
        == {"cb3": (3, 15), "e": (5, 12)}["cb3" if served.robot.series.cycle_Hz == 125.0 else "e"]
    )
    types = client.outputs(50.0, "timestamp,actual_TCP_pose,robot_mode,safety_status_bits")
    assert types == "DOUBLE,VECTOR6D,INT32,UINT32"
    assert client.ask("S") == b"\x01"
    command, data = client.receive()
    assert command == "U"
    recipe, _, *pose, mode, bits = struct.unpack(">Bd6diI", data)
    assert (recipe, mode, bits) == (1, 7, 1)
    assert pose == CENTRE
    assert not served.violations()


def test_a_moving_tool_has_a_speed_and_rests_without_one(served, client):
    client.outputs(125.0, "timestamp,actual_TCP_pose,actual_TCP_speed")
    client.ask("S")
    served.robot.move([*CENTRE[:2], CENTRE[2] + 0.1, *CENTRE[3:]], 0.02, 0.5)
    served.robot.tick(0.015)
    for speed, stop in ((0.0075, True), (0.0, False)):
        z_speed = None
        while z_speed != pytest.approx(speed, abs=1e-12):
            z_speed = struct.unpack(">Bd6d6d", client.receive()[1])[10]
        if stop:
            served.robot.halt(10.0)
            served.robot.tick(0.015)
    stamp, *pose = struct.unpack(">Bd6d6d", client.receive()[1])[1:8]
    assert stamp == served.robot.now == pytest.approx(0.03)
    assert CENTRE[2] < pose[2] < CENTRE[2] + 1e-4


def test_protocol_version_1_is_refused(served):
    client = RtdeClient(served.host)
    assert client.ask("V", struct.pack(">H", 1)) == b"\x00"
    client.close()


def test_a_paused_stream_is_silent_until_it_starts_again(client):
    client.outputs(125.0, "timestamp")
    client.ask("S")
    assert client.receive()[0] == "U"
    assert client.ask("P") == b"\x01"
    assert client.ask("v")  # nothing but the answer comes
    assert client.ask("S") == b"\x01"
    assert client.receive()[0] == "U"


def test_unknown_names_are_told_one_by_one(served, client):
    assert client.outputs(125.0, "timestamp,no_such") == "DOUBLE,NOT_FOUND"
    assert client.inputs("input_int_register_0,no_such") == (0, "INT32,NOT_FOUND")
    wrench = client.outputs(125.0, "ft_raw_wrench")
    assert wrench == ("NOT_FOUND" if served.robot.series.version[0] == 3 else "VECTOR6D")


def test_input_registers_belong_to_one_client_until_it_leaves(served, client):
    assert client.inputs("input_int_register_0,input_double_register_0")[1] == "INT32,DOUBLE"
    second_client = RtdeClient(served.host)
    second_client.ask("V", struct.pack(">H", 2))
    assert second_client.inputs("input_int_register_0,input_int_register_1") == (0, "IN_USE,INT32")
    assert second_client.inputs("input_int_register_1") == (1, "INT32")
    client.close()
    while second_client.inputs("input_int_register_0")[1] == "IN_USE":
        pass
    second_client.close()


def test_inputs_reach_the_controller(served, client):
    recipe, _ = client.inputs("input_int_register_3,input_double_register_5,external_force_torque")
    client.outputs(125.0, "timestamp")
    client.ask("S")
    client.send("U", struct.pack(">Bid6d", recipe, -7, 2.5, *range(6)))
    client.ask("v")
    assert served.robot.inputs["input_int_register_3"] == -7
    assert served.robot.inputs["input_double_register_5"] == 2.5
    assert served.robot.inputs["external_force_torque"] == list(range(6))


@pytest.mark.parametrize(
    ("command", "payload", "reason"),
    [
        ("U", b"\x05" + bytes(4), "recipe 05, never set up"),
        ("O", bytes(4), "at least a frequency"),
        ("O", struct.pack(">d", 1000.0) + b"timestamp", "frequency 1000"),
        ("O", struct.pack(">d", 10.0) + b"timestamp," * 250, "at most 2048"),
        ("S", b"", "start before outputs or inputs"),
        ("S", b"\x01", "start of 1 bytes"),
        ("X", b"", "unknown package"),
    ],
)
def test_what_breaks_the_protocol_is_a_violation_and_ends_the_connection(
    served, client, command, payload, reason
):
    client.send(command, payload)
    with pytest.raises(ConnectionError):
        client.receive()
    assert reason in served.violations()[0]


def test_data_of_the_wrong_length_is_a_violation(served, client):
    recipe, _ = client.inputs("input_int_register_0")
    client.send("U", struct.pack(">Bd", recipe, 0.0))
    with pytest.raises(ConnectionError):
        client.receive()
    assert "9 bytes of recipe 1, 5" in served.violations()[0]


def test_nothing_is_answered_before_the_protocol_version(served):
    client = RtdeClient(served.host)
    client.send("v")
    with pytest.raises(ConnectionError):
        client.receive()
    assert "before the protocol version" in served.violations()[0]


def test_several_clients_are_served_at_once_each_at_its_frequency(served):
    clients = [RtdeClient(served.host) for _ in range(3)]
    for client, frequency in zip(clients, (10.0, 50.0, 125.0), strict=True):
        client.ask("V", struct.pack(">H", 2))
        client.outputs(frequency, "timestamp,output_int_register_0")
        client.ask("S")
    for client in clients:
        for _ in range(3):
            assert client.receive()[0] == "U"
        client.close()
