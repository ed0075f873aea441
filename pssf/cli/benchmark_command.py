"""Command `benchmark`."""

from typing import Annotated

import typer

from .shared_options import (
    Engine,
    Matrix,
    Out,
    Processes,
    Scheduler,
)


def benchmark(
    *,
    out: Out,
    workers: Processes,
    subjects: Annotated[
        int, typer.Option(help="Number of subjects, distributed equally over the grades; 0 selects all 1,000 subjects.")
    ] = 0,
    protocols: Annotated[
        str,
        typer.Option(
            help="Names or TOML files of protocols for a trial run, separated by commas; default: fixed_flexion."
        ),
    ] = "",
    matrix: Matrix = 0,
    scheduler: Scheduler = None,
    engine: Engine = "scanline",
) -> None:
    """Make the frozen data set benchmark-1: images, fixed splits, baselines, datasheet, citation and Croissant file.

    All subjects need 52 GB and 2 h 18 min on two cores; 50 subjects need 2.6 GB and 13 minutes of CPU time. An
    interrupted run continues where it stopped; the final files are byte-identical. The baselines include a small
    network if PyTorch is installed.
    """
    from ..benchmark import make_benchmark
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from .shared_options import cohort_overrides

    execution = Execution(workers=workers, progress_bar=show_progress_bar, scheduler=scheduler)
    overrides = cohort_overrides("", -1, protocols, "", matrix=matrix)
    made = make_benchmark(out, execution, subjects=subjects, overrides=overrides, engine=engine)
    for row in made.baselines.to_dict("records"):
        where = f"{row['task']:<10} {row['model']:<10} {row['tested_on']:<28}"
        print(f"{where} AUC {row['auc']:.2f} ({row['auc_low']:.2f} to {row['auc_high']:.2f})")
    for note in made.notes:
        print(note)
    if made.hash_agreement[1]:
        print(f"frozen    {made.hash_agreement[0]} of {made.hash_agreement[1]} subjects have the published hashes")
    print(f"folder    {made.folder}")
