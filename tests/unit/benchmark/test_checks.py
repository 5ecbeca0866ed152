"""The table of checks: a row a file, with what was said."""

from benchmark import checks
from eitskin.data import recording
from small_skin import small_recording


def test_every_file_has_its_row_and_verdict(tmp_path, capsys):
    recording.write(small_recording(places=2), tmp_path / "skin.parquet")
    (tmp_path / "words.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    (tmp_path / "words.md").write_text("of them", encoding="utf-8")
    assert checks.main([str(tmp_path)]) == 0
    _, _, skin, words = capsys.readouterr().out.splitlines()
    cells = skin.split(" | ")
    assert cells[0] == "| skin.parquet" and cells[3].startswith("usable")
    assert 0.0 < float(cells[2]) < 1.0
    assert words.startswith("| words.csv | ") and "| refused: format: found text that" in words
    assert checks.main([str(tmp_path / "absent")]) == 2
