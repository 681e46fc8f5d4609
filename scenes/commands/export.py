"""``ideal-robot export``: recordings in the formats of other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    recording: Annotated[Path, typer.Argument(help="Recording (Parquet, CSV, ROS 2 bag or MCAP).")],
    mcap: Annotated[Path | None, typer.Option(help="MCAP file with ROS 2 messages, for Foxglove.")] = None,
    rosbag2: Annotated[Path | None, typer.Option(help="Folder of a ROS 2 bag.")] = None,
    rerun: Annotated[Path | None, typer.Option(help="Rerun file (.rrd); needs the extra 'rerun'.")] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV file.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Parquet file.")] = None,
) -> None:
    """Writes a recording as MCAP, ROS 2 bag, Rerun file, CSV or Parquet; several at once if wanted.

    Example: `ideal-robot export out/line/recording.parquet --mcap line.mcap`
    """
    from ideal_robot.errors import InputError
    from ideal_robot.signals.recording import Recording
    from ideal_robot.signals.ros_export import write_mcap, write_rosbag2
    from scenes.export.rerun_file import write_rerun
    from scenes.outputs import check_outputs
    from scenes.terminal import progress_bar

    # The one that needs an extra comes first: where that is missing nothing has been written.
    writers = {"--rerun": (rerun, write_rerun), "--mcap": (mcap, write_mcap), "--rosbag2": (rosbag2, write_rosbag2),
               "--csv": (csv, Recording.write), "--parquet": (parquet, Recording.write)}
    wanted = {option: (path, writer) for option, (path, writer) in writers.items() if path is not None}
    if not wanted:
        raise InputError(f"say which format: {', '.join(writers)}", field="export")
    for option, path, ending in (("--mcap", mcap, ".mcap"), ("--rerun", rerun, ".rrd"), ("--csv", csv, ".csv"),
                                 ("--parquet", parquet, ".parquet")):
        if path is not None and path.suffix != ending:
            raise InputError(f"expected a name ending in {ending}", field=option, value=str(path))
    if rosbag2 is not None and rosbag2.exists():
        raise InputError("a bag is a new folder; choose a name that does not exist", field="--rosbag2",
                         value=str(rosbag2))
    check_outputs({"--rosbag2": rosbag2}, mcap=mcap, rerun=rerun, csv=csv, parquet=parquet)
    loaded = Recording.read(recording)
    with progress_bar("export") as progress:
        for i, (option, (path, writer)) in enumerate(wanted.items()):
            progress(i / len(wanted), option[2:])
            typer.echo(f"written: {writer(loaded, path)}")
