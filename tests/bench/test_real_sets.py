"""Splits of real flights that are drawn."""

from bench.real.sets import SETS, drawn

BRUSHED = next(one for one in SETS if one.name == "brushed")


def test_drawn_splits_fit_and_hold_out_flights_of_the_folder_and_none_twice(tmp_path):
    folder = tmp_path / BRUSHED.folder
    folder.mkdir()
    names = {f"jana{number:02d}" for number in range(1, 7)}
    for name in (*names, "README.md", "LICENSE"):
        (folder / name).touch()
    found = drawn(BRUSHED, tmp_path, 3, 20)
    assert found == drawn(BRUSHED, tmp_path, 3, 20)
    assert found != drawn(BRUSHED, tmp_path, 4, 20)
    assert {len(one.fitted) for one in found.splits} == {1, 2, 3}
    for one in found.splits:
        assert one.held
        flown = [*one.fitted, *one.held]
        assert len(set(flown)) == len(flown)
        assert names.issuperset(flown)
