"""What the bench of plans times."""

from pathlib import Path

from benchmark import plans


def test_provenance_of_a_job_is_recorded_within_its_limit(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert 0.0 < min(1000.0 * plans.recording_s() for _ in range(3)) < plans.LIMIT_MS
    assert Path.cwd() == tmp_path and not list(tmp_path.iterdir())
