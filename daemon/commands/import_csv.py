"""`ramstroke import`."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = (
    "Make a recording from a table of inertial samples. Columns: t_s, gyro_{x,y,z}_rad_s, accel_{x,y,z}_m_s2; "
    "optional temperature_c, observed_mm, reference_mm. Other columns are ignored. Values are kept as given."
)
EXAMPLE = "ramstroke import bench.csv.gz -o bench.mcap --config bench.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", type=Path, help="the table (.csv or .csv.gz)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the recording to write (.mcap)")
    parser.add_argument("--config", type=Path, help="configuration to store in it (default: all defaults)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Import."""
    from daemon import terminal
    from daemon.configuration import load
    from daemon.offline.importer import import_csv
    from daemon.settings import Settings

    settings = load(arguments.config) if arguments.config else Settings()
    with terminal.progress(f"reading {arguments.file.name}") as progress:
        report = import_csv(arguments.file, arguments.output, settings.model_dump_json(), progress=progress)
    if arguments.json:
        terminal.print_json(
            {
                "rows": report.rows,
                "dropped": report.dropped,
                "dropped_values": report.dropped_values,
                "ignored_columns": report.ignored,
                "duration_s": report.duration_s,
                "rate_hz": report.rate_hz,
            }
        )
        return 0
    terminal.say(
        f"{report.rows} samples over {report.duration_s:.1f} s ({report.rate_hz:.1f} per second) in {arguments.output}"
    )
    for reason, count in (report.dropped | report.dropped_values).items():
        terminal.say(f"dropped: {count} × {reason}")
    if report.ignored:
        terminal.say(f"ignored columns: {', '.join(report.ignored)}")
    return 0
