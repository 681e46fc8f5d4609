"""``ideal-robot detect``: the line detector on pictures, videos and cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    source: Annotated[str, typer.Argument(help="A picture, a folder of pictures, a video, the number of a camera, or "
                                               "an rtsp:// or http:// address.")],
    detector: Annotated[str, typer.Option(help="What finds the points: edge_pairs or opencv.")] = "edge_pairs",
    points: Annotated[int, typer.Option(help="Points along the line.", min=5, max=200)] = 15,
    every: Annotated[int, typer.Option(help="Takes one of so many frames of a video or stream.", min=1)] = 1,
    most: Annotated[int, typer.Option(help="Ends after so many pictures.", min=1)] = 100,
    json: Annotated[Path | None, typer.Option(help="Write points and polynomials as JSON to this file.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the page.")] = Path("out/detect"),
) -> None:
    """Finds the drawn line in pictures of your own cell, before anything moves: points, polynomial, how sure, why not.

    Width and polarity of the line are found in the picture. Exit code 1 where no picture shows a line.

    Example: `ideal-robot detect pictures/ --json line.json`
    """
    from ideal_robot.whole_file import whole_files
    from scenes.commands.common import show_table
    from scenes.detection import detection_page, figures, pictures, table
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.terminal import progress_bar
    from sensing.camera.camera_device import Gray
    from sensing.camera.opencv_detector import DETECTORS
    from sensing.camera.picture_line import PictureLine, detect_in_picture

    chosen = DETECTORS.get(detector)()
    results: list[tuple[str, Gray, PictureLine]] = []
    check_outputs({"--out": out}, json=json)
    with progress_bar("detect") as progress:
        for name, gray in pictures(source, every=every, most=most):
            progress(min(0.9, len(results) / most), name)
            results.append((name, gray, detect_in_picture(gray, chosen, points=points)))
        progress(0.95, "page")
        report = out / "report.html"
        with whole_files(report, json) as (page_file, json_file):
            detection_page(source, detector, results).write(page_file)
            if json_file is not None:
                write_json(json_file, {"source": source, "detector": detector,
                                       "pictures": [figures(name, found) for name, _, found in results]})
    show_table("detect", *table(results))
    typer.echo(f"report: {report}")
    if not any(found.found for _, _, found in results):
        typer.echo("ideal-robot: no picture shows a line", err=True)
        raise typer.Exit(1)
