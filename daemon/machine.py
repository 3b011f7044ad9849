"""Which machine the settings describe: what was learned on one support does not hold for another."""

from __future__ import annotations

from daemon.settings import Settings
from drivers.can.dbc import signal_name
from estimation.learned import Machine


def machine_of(settings: Settings) -> Machine:
    """The support, and the signal of its displacement sensor if there is one.

    The assumed age of a reading belongs to the signal: what is learned of its latency comes on top of that.
    """
    displacement = settings.can.displacement
    signal = f"{signal_name(displacement)}, {displacement.latency_ms:g} ms old" if settings.can.enabled else ""
    return Machine.of(settings.support, signal)
