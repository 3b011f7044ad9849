"""Who stands still."""

from __future__ import annotations

from daemon.service.watchdog import PATIENCE_S, Watchdog, hanging


class Counter:
    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> int:
        return self.count


def test_a_part_that_counts_on_is_never_named() -> None:
    imu, watchdog = Counter(), Watchdog()
    watchdog.watch("imu", imu)
    for second in range(100):
        imu.count += 1
        assert watchdog.laggards(second) == {}


def test_a_part_that_stands_still_is_named_after_its_patience_and_no_other() -> None:
    imu, can, watchdog = Counter(), Counter(), Watchdog()
    watchdog.watch("imu", imu)
    watchdog.watch("can", can)
    watchdog.laggards(0.0)
    named = {}
    for second in range(1, 10):
        imu.count += 1
        named[second] = watchdog.laggards(second)
    assert [second for second, who in named.items() if who] == [s for s in range(1, 10) if s >= PATIENCE_S]
    assert named[9] == {"can": 9.0}
    can.count += 1
    assert watchdog.laggards(10) == {}


def test_a_part_that_need_not_work_may_rest_and_has_its_full_patience_afterwards() -> None:
    estimator, watchdog = Counter(), Watchdog()
    wanted: list[bool] = []
    watchdog.watch("estimator", estimator, expected=lambda: bool(wanted))
    assert [watchdog.laggards(second) for second in (0, 50, 100)] == [{}] * 3
    wanted.append(True)
    assert watchdog.laggards(100 + PATIENCE_S - 0.1) == {}
    assert watchdog.laggards(100 + PATIENCE_S) == {"estimator": PATIENCE_S}


def test_only_what_has_used_up_half_of_systemds_patience_is_told_to_hang() -> None:
    assert hanging({"imu": PATIENCE_S + 4.9, "can": PATIENCE_S}, limit_s=10.0) == {}
    told = hanging({"imu": PATIENCE_S + 5.5, "can": PATIENCE_S}, limit_s=10.0)
    assert told == {"imu": "imu has stood still for 10 s: unless it goes on, systemd starts the program anew in 4 s"}
    assert hanging({"imu": 60.0}, limit_s=10.0)["imu"].endswith("in 0 s")


def test_without_systemd_no_start_is_announced() -> None:
    assert hanging({"imu": 60.0}, limit_s=None) == {
        "imu": "imu has stood still for 60 s: no watchdog starts the program anew"
    }
