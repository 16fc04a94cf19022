import pytest
from matplotlib.figure import Figure

from bp2_rl.base.plotting import save_figure


def test_a_picture_that_cannot_be_finished_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "picture.png"
    save_figure(Figure(), path)
    before = path.read_bytes()
    assert before.startswith(b"\x89PNG")

    def run_out_of_disk(_, file, **__):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", run_out_of_disk)
    with pytest.raises(OSError, match="No space left"):
        save_figure(Figure(), path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["picture.png"]
