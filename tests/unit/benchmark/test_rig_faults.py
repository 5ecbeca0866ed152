"""What the benchmark of faults says of a capture, and that its configurations are a rig's own."""

import pandas as pd

from benchmark import rig_faults
from eitskin.capture import configuration
from rigsim.config import read_config


def test_its_configurations_are_accepted(tmp_path):
    for fault in rig_faults.FAULTS.values():
        emulator, driver = rig_faults.configurations(tmp_path, 3, {"probes_mm": [15.0]}, [fault])
        configuration.validate(driver, "rig.yaml")
        path = tmp_path / "rigsim.yaml"
        path.write_text(rig_faults.yaml.safe_dump(emulator))
        assert read_config(path)["faults"] == [fault]


def test_a_press_with_a_fault_that_counts_as_finished_is_told():
    fault = {"event": "fault", "now": {"contact": 2, "force_N": 1.0, "largest_N": 9.0}}
    events = [
        {"event": "touched"},
        fault,
        {"event": "violation"},
        {"event": "end", "largest_N": 9.0},
    ]
    ends = [{"kind": "end", "contact": number} for number in (0, 1)]
    spoilt = rig_faults._outcome(events, ends)
    assert spoilt["spoilt_finished"] and not spoilt["stopped"]
    stopped = rig_faults._outcome(events, [*ends[:1], {"kind": "stop", "reason": "late"}])
    assert stopped["stopped"] and not stopped["spoilt_finished"]
    table = pd.DataFrame([{"fault": "a board"} | outcome for outcome in (spoilt, stopped)])
    command = {"starts": 2, "presses": 0, "commit": "c", "hard_N": 20.0}
    assert "| a board | 2 | 1 | 1 | 9.00 | 2 | 1 late |" in rig_faults.page(table, command)
