"""The stages of the study in order; the one module of it that knows the clock and, through `files`, the disk."""

import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import pandas as pd

from ..checks import InputError, require_choice
from ..files import results
from ..parallel import ordered_map
from ..radiomics.region import Template
from ..radiomics.table import NOT_FEATURES, How, Job, Load, Record, extract_all
from . import Progress, StudyResult, StudySettings, localisation
from .baselines import SOURCES, measures_of, with_measures
from .checklist import checklist
from .claims import claims
from .environment import environment
from .evidence import Tables, joined, tables_of_features, tables_of_models
from .gallery import gallery
from .importance import by_family
from .reliability import REPEATS, count_stable
from .report import Findings, Picture, render
from .scenarios import Outcome, one_split
from .selection import is_degenerate

_COLUMNS = (
    *("radiograph", "subject", "knee", "side", "grade", "protocol", "file", "sha256"),
    *("pixel_mm", "sdd_mm", "sod_mm", "truth_medial_row_px", "truth_medial_col_px"),
)
_PACKAGES = (
    *("pssf", "pyradiomics", "scikit-learn", "xgboost-cpu", "feature-engine", "scikit-image", "skops"),
    *("scipy", "numpy", "pandas"),
)
_COUNTED = {"subjects": "subject", "knees": "knee", "protocols": "protocol", "radiographs": "radiograph"}
_TEXT = ("radiograph", "sha256", "settings", "status")


def run_study(
    manifest: pd.DataFrame,
    load_pixels: Load,
    template: Template,
    settings: StudySettings,
    out: Path,
    *,
    again: pd.DataFrame | None,
    seconds: dict[str, float],
    workers: int,
    progress: Progress | None,
) -> StudyResult:
    """See `pssf.study.run`."""
    check_manifest(manifest, settings)
    everything, seconds = _everything(manifest, again), dict(seconds)
    tell = progress or (lambda stage, done, of: None)
    with _timed(seconds, "regions and features"):
        table, work = _measured(everything, load_pixels, template, settings, out, workers, tell)
    names = [name for name in table.columns if name not in (*NOT_FEATURES, *everything.columns)]
    located = localisation.errors(with_measures(table[table["kind"] == ""]))
    repeated = table[(table["kind"] != "") & (table["status"] == "found")]
    usable = located[located["status"] == "found"]
    _require_enough(usable, settings)
    with _timed(seconds, "training and testing"):
        outcomes = _outcomes(usable, names, settings, workers, tell)
    predictions = joined([outcome.predictions for outcome in outcomes])
    if predictions.empty:
        raise InputError("regions found = too few to train on; allowed: grades 0 and 2 found among training subjects")
    with _timed(seconds, "intervals and differences"):
        tables = tables_of_models(outcomes, settings)
    with _timed(seconds, "reliability and figures"):
        tables = tables_of_features(located, repeated, names, settings.reference) | tables
        pictures = gallery(located, load_pixels, settings, predictions, tables)
    with _timed(seconds, "claims"):
        importances = joined([outcome.importances for outcome in outcomes])
        tables["claims"] = claims(usable, predictions, importances, tables, settings)
    findings = _findings(located, names, settings, tables, outcomes, pictures, seconds, work, workers)
    return _write(out, findings, tables | {"predictions": predictions}, outcomes)


def check_manifest(manifest: pd.DataFrame, settings: StudySettings) -> None:
    """Refuse a manifest that lacks a column, has no reference protocol, or names a radiograph twice.

    raises  InputError
    """
    missing = [name for name in _COLUMNS if name not in manifest.columns]
    if missing:
        raise InputError(f"manifest: columns {', '.join(missing)} are missing; required: {', '.join(_COLUMNS)}")
    require_choice("reference", settings.reference, sorted(set(manifest["protocol"])))
    twice = manifest["radiograph"][manifest["radiograph"].duplicated()]
    if len(twice):
        raise InputError(f"manifest: radiograph {twice.iloc[0]} is listed twice; allowed: once")


def _everything(manifest: pd.DataFrame, again: pd.DataFrame | None) -> pd.DataFrame:
    """The manifest, the columns that the study reads, and below it what was taken again; `kind` tells them apart."""
    columns = [*_COLUMNS, *(name for name in SOURCES if name in manifest)]
    first = manifest[columns].assign(kind="", turn="")
    if again is None or again.empty:
        return first
    missing = [name for name in (*columns, "kind", "turn") if name not in again]
    if missing:
        raise InputError(f"manifest of repeats: columns {', '.join(missing)} are missing; required: as in the manifest")
    for kind in again["kind"].unique():
        require_choice("kind of repeat", kind, tuple(REPEATS))
    both = pd.concat([first, again[[*columns, "kind", "turn"]]], ignore_index=True)
    twice = both["radiograph"][both["radiograph"].duplicated()]
    if len(twice):
        raise InputError(f"manifest of repeats: radiograph {twice.iloc[0]} is listed twice; allowed: once")
    return both


def _require_enough(usable: pd.DataFrame, settings: StudySettings) -> None:
    of_reference = usable[usable["protocol"] == settings.reference]
    found = sorted({int(grade) for grade in of_reference["grade"]})
    if not {0, 2} <= set(found):
        raise InputError(
            f"grades with a region found under {settings.reference} = {found}; allowed: 0 and 2 among them, with three "
            "subjects or more"
        )


def _measured(
    manifest: pd.DataFrame,
    load_pixels: Load,
    template: Template,
    settings: StudySettings,
    out: Path,
    workers: int,
    tell: Progress,
) -> tuple[pd.DataFrame, dict[str, float]]:
    """The manifest with what was found in each radiograph; kept in features.csv, from which a later run goes on."""
    path = out / "features.csv"
    earlier = results.load_table(path, _TEXT)
    known: dict[str, Record] = {}
    if earlier is not None and {"sha256", "settings"} <= set(earlier.columns):
        known = {row["sha256"]: row for row in earlier.to_dict("records")}
    columns = ("radiograph", "file", "sha256", "side", "pixel_mm")
    jobs = [Job(**{name: row[name] for name in columns}) for row in manifest[list(columns)].to_dict("records")]
    records, work = extract_all(
        jobs,
        load_pixels=load_pixels,
        template=template,
        how=How(region_px=settings.region_px, bins=settings.bins, min_score=settings.min_score),
        workers=workers,
        known=known,
        save=lambda records: results.save_table(path, pd.DataFrame(records)),
        progress=partial(tell, "regions and features"),
    )
    found = pd.DataFrame(records).drop(columns="sha256")
    return manifest.merge(found, on="radiograph", how="left", validate="one_to_one").copy(), work


def _outcomes(
    usable: pd.DataFrame, names: list[str], settings: StudySettings, workers: int, tell: Progress
) -> list[Outcome]:
    done = 0

    def arrived(_: int, __: Outcome) -> None:
        nonlocal done
        done += 1
        tell("training and testing", done, settings.repeats)

    table = usable[["radiograph", "knee", "subject", "grade", "protocol", *measures_of(usable), *names]]
    shared = {"table": table, "names": names, "settings": settings}
    return ordered_map(one_split, range(settings.repeats), shared=shared, workers=workers, arrived=arrived)


def _findings(
    located: pd.DataFrame,
    names: list[str],
    settings: StudySettings,
    tables: Tables,
    outcomes: list[Outcome],
    pictures: dict[str, Picture],
    seconds: dict[str, float],
    work_seconds: dict[str, float],
    workers: int,
) -> Findings:
    usable = located[located["status"] == "found"]
    keys = ["model", "selection", "feature"]
    importance = tables["importance"].merge(tables["permutation"][[*keys, "drop"]], on=keys, how="left")
    shown = importance[importance["selection"] == settings.selections[0]]
    grouped = located.groupby("grade")
    composition = grouped.agg(subjects=("subject", "nunique"), knees=("knee", "nunique"), radiographs=("knee", "size"))
    counts = {name: int(located[column].nunique()) for name, column in _COUNTED.items()}
    tested = tables["splits"]["test_subjects"]
    return Findings(
        counts=counts | {"regions refused": len(located) - len(usable)},
        composition=composition.reset_index(),
        localisation=tables["localisation"],
        scores=tables["scores"],
        differences=tables["differences"],
        claims=tables["claims"],
        calibration=tables["calibration"],
        families=by_family(shown).join(by_family(shown, "drop").add_suffix(" drop")),
        screened=[outcome.stable for outcome in outcomes if outcome.stable is not None],
        models=sorted(outcomes[0].models),
        stable=count_stable(tables["reliability"]),
        leading=shown.groupby("model", sort=False).head(5),
        degenerate=[name for name in names if is_degenerate(usable[name].to_numpy())],
        pictures=pictures,
        settings=asdict(settings),
        versions={"python": platform.python_version()} | {name: version(name) for name in _PACKAGES},
        seconds=seconds,
        work_seconds=work_seconds,
        workers=workers,
        features=len(names),
        test_subjects=(int(tested.min()), int(tested.max())),
    )


def _write(out: Path, findings: Findings, tables: Tables, outcomes: list[Outcome]) -> StudyResult:
    """Tables, pictures, models, study.json and the page; of two runs on one cohort and settings only times differ."""
    pictures = {}
    for name, picture in findings.pictures.items():
        pictures[name] = out / "pictures" / f"{name}.png"
        results.save_bytes(pictures[name], picture.png)
    written = {name: out / f"{name}.csv" for name in tables}
    for name, table in tables.items():
        results.save_table(written[name], table)
    models = {name: out / "models" / f"{name}.skops" for name in sorted(outcomes[0].models)}
    for name, path in models.items():
        results.save_bytes(path, outcomes[0].models[name])
    facts = ("counts", "features", "degenerate", "settings", "versions", "seconds", "workers")
    results.save_json(out / "study.json", {name: getattr(findings, name) for name in facts})
    results.save_json(out / "environment.json", environment())
    results.save_text(out / "report.html", render(findings))
    results.save_json(out / "checklist.json", checklist(out))
    return StudyResult(
        report=out / "report.html",
        pictures=pictures,
        tables={"features": out / "features.csv", **written},
        models=models,
        scores=tables["scores"],
        differences=tables["differences"],
        reliability=tables["reliability"],
        localisation=tables["localisation"],
        seconds=findings.seconds,
    )


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    began = perf_counter()
    yield
    seconds[stage] = perf_counter() - began
