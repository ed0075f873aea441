"""The command benchmark."""

from typing import Annotated

import typer

from .options import Engine, Matrix, Out, Processes, Scheduler


def benchmark(
    *,
    out: Out,
    workers: Processes,
    people: Annotated[
        int, typer.Option(help="So many of the 1,000 people, of the grades alike, with the same images; 0: all.")
    ] = 0,
    protocols: Annotated[
        str,
        typer.Option(help="Names or TOML files, with commas, instead of fixed_flexion: to try it with."),
    ] = "",
    matrix: Matrix = 0,
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
) -> None:
    """The frozen data set benchmark-1: images, fixed splits, baselines, datasheet, citation, Croissant file.

    The whole is 52 GB and 2 h 18 min on two cores; 50 people are 2.6 GB and 13 minutes of CPU.
    Goes on where an earlier run stopped or was killed, and ends with the same bytes. A small network is among the
    baselines where PyTorch is installed.
    """
    from ..benchmark import make_benchmark
    from ..core.execution import Execution
    from ..core.progress import bar
    from .options import cohort_overrides

    execution = Execution(workers=workers, bar=bar, scheduler=scheduler)
    overrides = cohort_overrides("", -1, protocols, "", matrix=matrix)
    made = make_benchmark(out, execution, people=people, overrides=overrides, engine=engine)
    for row in made.baselines.to_dict("records"):
        where = f"{row['task']:<10} {row['model']:<10} {row['tested_on']:<28}"
        print(f"{where} AUC {row['auc']:.2f} ({row['auc_low']:.2f} to {row['auc_high']:.2f})")
    for note in made.notes:
        print(note)
    if made.frozen[1]:
        print(f"frozen    {made.frozen[0]} of {made.frozen[1]} people are as they were frozen")
    print(f"folder    {made.folder}")
