from itertools import pairwise

from groundstation.page.follower import KEPT_S, _Table


def shown(times_s):
    table = _Table(["roll"])
    for number, time_s in enumerate(times_s):
        table.put(number, time_s, [0.0])
    return [time_s for _, time_s, _ in table.rows]


def test_rows_are_shown_when_they_were_measured():
    times_s = [100.0 + 0.02 * row for row in range(50)]
    assert shown(times_s) == times_s


def test_a_clock_that_is_set_back_moves_no_row_back_and_is_right_again_in_the_end():
    """A first packet that was 0.43 s on its way: the next one shows that it is earlier there."""
    before = [100.0 + 0.02 * row for row in range(50)]
    after = [before[-1] - 0.43 + 0.02 * row for row in range(200)]
    found = shown([*before, *after])
    assert all(b > a for a, b in pairwise(found))
    assert found[-1] == after[-1]


def test_another_craft_whose_clock_began_anew_goes_on_after_the_last_one():
    found = shown([100.0, 100.02, 3.0, 3.02, 3.04])
    assert all(b > a for a, b in pairwise(found))


def test_only_the_last_seconds_are_kept():
    found = shown([100.0 + row for row in range(60)])
    assert found[0] >= found[-1] - KEPT_S
