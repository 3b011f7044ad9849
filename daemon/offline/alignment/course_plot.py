"""The angles of an alignment as they come out over its rest: figure 7 of paper B for a recording of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from daemon.imu.roles import Role
from daemon.offline.alignment.align import AXES, Alignment
from daemon.offline.alignment.paper_figures import SETTLED, around, figure_of, save
from daemon.offline.alignment.rest import BLOCK_S
from daemon.offline.plots import BLUE, ORANGE
from estimation.alignment.verdict import Verdict

_COLOURS: dict[Role, str] = {"main": BLUE, "beside": ORANGE}


def draw_course(found: Mapping[Role, Alignment], names: Mapping[Role, str], file: str, folder: Path) -> Path:
    """Each angle of each sensor against time with its band of one sigma."""
    figure, axes = figure_of(1, f"alignment on the rest of {file}")
    for i, (axis, (one,)) in enumerate(zip(AXES, axes, strict=True)):
        shown = []
        for role, alignment in found.items():
            label, colour = names[role], _COLOURS[role]
            angle, sigma = np.degrees(alignment.course[:, i]), np.degrees(alignment.course_sigma[:, i])
            if axis == "heading":
                angle = np.degrees(np.unwrap(alignment.course[:, i]))
            # A filter that does without the first part of the rest ends with it all the same.
            t_s = alignment.rest_s - BLOCK_S * np.arange(len(angle) - 1, -1, -1)
            settled = slice(min(SETTLED, len(angle) - 1), None)
            if alignment.angles[i].verdict is Verdict.REFUSED:
                continue
            shown += [angle[settled] - 1.2 * sigma[settled], angle[settled] + 1.2 * sigma[settled]]
            if len(angle) == 1:  # a coarse alignment is one answer for the whole rest
                one.errorbar(t_s, angle, sigma, color=colour, label=f"{label} ± 1σ", fmt="o", capsize=4)
                continue
            one.plot(t_s, angle, color=colour, label=label, linewidth=1.5)
            one.fill_between(
                t_s, angle - sigma, angle + sigma, color=colour, alpha=0.15, linewidth=0, label=f"{label}: ± 1σ"
            )
        limits = np.concatenate(shown) if shown else np.empty(0)
        if len(limits) and np.isfinite(limits).all():
            one.set_ylim(*around(limits))
        one.set_ylabel(f"{axis} [deg]")
        told = "; ".join(f"{names[role]}: {alignment.angles[i].verdict}" for role, alignment in found.items())
        one.set_title(told, fontsize=9)
    return save(figure, axes, folder / "alignment.png")
