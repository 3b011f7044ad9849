"""Long records made small: nothing is lost that a plot must show."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from daemon.offline.report.reduction import ALL_SAMPLES, AROUND_NS, CELL_NS, MOST_CELLS, Grid, runs, windows, within

times = st.lists(st.integers(0, 10**13), min_size=1, max_size=200).map(sorted)
numbers = st.floats(-1e6, 1e6, width=32) | st.just(float("nan"))


@given(times, st.data())
def test_an_envelope_contains_every_sample_and_no_more(t_ns: list[int], data: st.DataObject) -> None:
    values = data.draw(st.lists(numbers, min_size=len(t_ns), max_size=len(t_ns)))
    grid = Grid.over(t_ns[0], t_ns[-1])
    low, high = grid.envelope(np.array(t_ns), np.array(values, dtype=np.float32))
    of_cells: dict[int, list[float]] = {}
    for t, value in zip(t_ns, values, strict=True):
        cell = (t - grid.begin_ns) // grid.cell_ns
        assert 0 <= cell < grid.cells
        if value == value:
            of_cells.setdefault(cell, []).append(value)
    for cell in range(grid.cells) if grid.cells < 500 else [*of_cells, 0, grid.cells - 1]:
        if cell in of_cells:
            assert (low[cell], high[cell]) == (min(of_cells[cell]), max(of_cells[cell]))
        else:
            assert np.isnan(low[cell])
            assert np.isnan(high[cell])
    assert np.isfinite(low).sum() == len(of_cells)


@given(times)
def test_the_grid_covers_the_record_with_ten_cells_a_second_or_as_many_as_a_page_can_hold(t_ns: list[int]) -> None:
    grid = Grid.over(t_ns[0], t_ns[-1])
    assert grid.begin_ns == t_ns[0]
    assert t_ns[-1] < grid.begin_ns + grid.cells * grid.cell_ns <= t_ns[-1] + 1 + grid.cell_ns
    assert grid.cells <= MOST_CELLS
    assert grid.cell_ns == CELL_NS or grid.cells > MOST_CELLS // 2


def test_an_envelope_of_two_signals_is_the_least_of_one_and_the_largest_of_the_other() -> None:
    t_ns = np.array([0, 1, CELL_NS, CELL_NS + 1])
    low, high = Grid(0, CELL_NS, 2).envelope(
        t_ns, np.array([1, 0, 5, 6], dtype=np.float32), np.array([2, 9, 7, 6.5], dtype=np.float32)
    )
    assert low.tolist() == [0, 5]
    assert high.tolist() == [9, 7]


@given(st.lists(st.integers(0, 10**12), max_size=30))
def test_around_marks_all_is_kept_and_stretches_do_not_meet(marks: list[int]) -> None:
    t_ns = np.linspace(0, 10**12, ALL_SAMPLES + 1).astype(np.int64)
    kept = windows(marks, 0, 10**12, len(t_ns))
    assert all(before[1] < after[0] for before, after in pairwise(kept))
    expected = np.zeros(len(t_ns), dtype=np.bool_)
    for mark in marks:
        expected |= np.abs(t_ns - mark) <= AROUND_NS
    assert np.array_equal(within(kept, t_ns), expected)


@given(st.lists(st.integers(-(10**10), 10**12 + 10**10), max_size=30))
def test_stretches_grow_to_whole_cells_and_no_further(marks: list[int]) -> None:
    grid = Grid.over(5, 10**12)
    kept = windows(marks, 5, 10**12, ALL_SAMPLES + 1)
    aligned = grid.aligned(kept)
    assert all(before[1] + 1 < after[0] for before, after in pairwise(aligned))
    cells = {
        cell
        for begin, end in kept
        for cell in range(max(0, (begin - 5) // CELL_NS), min(grid.cells, (end - 5) // CELL_NS + 1))
    }
    told = [range((begin - 5) // CELL_NS, (end + 1 - 5) // CELL_NS) for begin, end in aligned]
    assert all((begin - 5) % CELL_NS == 0 == (end + 1 - 5) % CELL_NS for begin, end in aligned)
    assert {cell for some in told for cell in some} == cells


def test_a_short_record_is_kept_whole() -> None:
    t_ns = np.arange(ALL_SAMPLES) * 1000
    assert within(windows([], 0, int(t_ns[-1]), len(t_ns)), t_ns).all()


def test_runs_follow_each_other_without_a_hole() -> None:
    t_ns = np.array([10, 20, 30, 40, 50])
    assert runs(t_ns, np.array([0, 0, 2, 2, 1], dtype=np.uint8)) == [(10, 30, 0), (30, 50, 2), (50, 50, 1)]
    assert runs(t_ns[:0], np.empty(0, dtype=np.uint8)) == []
