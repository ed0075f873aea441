"""The stages of the study in order; the one module of it that knows, through `io`, the disk."""

import platform
from dataclasses import asdict, replace
from importlib.metadata import version

import pandas as pd

from ..core.checks import InputError
from ..io import results
from ..radiomics.backends import BACKENDS
from ..radiomics.compact import compact
from ..radiomics.processing import processing
from .design import Designed
from .external import Bench, check_films, tested_on_films, trained_on
from .films import FilmSet
from .learn.modelfile import SUFFIX, pack
from .learn.refit import refitted
from .learn.training import train
from .libraries import XGBOOST
from .manifest_checks import require_designed
from .measuring import Run, check_manifest, measured
from .predictions import Outcome, joined
from .questions import ask
from .report.checklist import checklist
from .report.cost import cost_rows
from .report.environment import environment
from .report.film_figures import film_pictures
from .report.gallery import gallery
from .report.page import Findings, Picture, render
from .report.sections import segmentation_section
from .result import StudyResult
from .segmentation import segmentation
from .settings import StudySettings
from .statistics import localisation
from .statistics.claims import claims
from .statistics.degenerate import is_degenerate
from .statistics.dimensions import dimensions, tuned
from .statistics.evidence import Tables, tables_of_features, tables_of_models, tables_of_truth
from .statistics.importance import by_family
from .statistics.parameters import composition, morphology, parameters_of, with_measures
from .statistics.provenance import notes_of, warnings_of
from .statistics.reliability import count_stable, protocols_of
from .tables import laws_of
from .tasks import class_names

_PACKAGES = (
    *("pssf", "scikit-learn", XGBOOST, "feature-engine", "scikit-image", "skops"),
    *("scipy", "numpy", "pandas"),
)
_COUNTED = {"subjects": "subject", "knees": "knee", "protocols": "protocol", "radiographs": "radiograph"}


def run_study(
    run: Run,
    manifest: pd.DataFrame,
    retest: pd.DataFrame | None,
    films: FilmSet | None = None,
    designed: Designed | None = None,
) -> StudyResult:
    """See `pssf.study.run`."""
    settings, timer, designed = run.settings, run.execution.timer, require_designed(designed or Designed())
    laws = laws_of(manifest := check_manifest(manifest, settings))
    if films is not None:
        check_films(films, manifest, settings, run.templates)
    table, names, work = measured(run, manifest, retest)
    located = localisation.errors(with_measures(table[table["kind"] == ""]))
    repeated = table[(table["kind"] != "") & (table["status"] == "found")]
    usable = located[located["status"] == "found"]
    _require_enough(usable, settings)
    outcomes = train(usable, names, settings, run.execution)
    predictions = joined(outcome.predictions for outcome in outcomes)
    if predictions.empty:
        raise InputError(
            f"regions found = {len(usable)}, in no split of grades 0 and 2 in training; allowed: of both in one or more"
        )
    with timer.stage("intervals and differences"):
        tables = tables_of_models(outcomes, settings)
    with timer.stage("reliability and figures"):
        tables = tables_of_features(located, repeated, names, run.tables.radiomics.tags, settings) | tables
        tables["morphology"] = morphology(parameters_of(manifest), None if laws is None else laws.grades)
        tables |= tables_of_truth(manifest, usable, names, predictions, tables["subjects"], settings)
        pictures = gallery(located, run.load_pixels, settings, predictions, tables)
    with timer.stage("claims"):
        tables |= _of_models(outcomes, usable, names, predictions, tables, settings)
    tables["segmentation"] = segmentation(repeated, retest, run)
    with timer.stage("models refitted"):
        models = _models(run, usable, names, manifest)
    answers, external = ask(run, manifest, usable, names, tables, designed, laws), None
    tables |= answers.tables
    pictures |= answers.pictures()
    if films is not None:
        bench = Bench(run.templates, settings, run.out, run.execution, run.tables.radiomics)
        external = tested_on_films(bench, films, manifest)
        tables |= external.tables
        models |= external.models
        pictures |= film_pictures(external, settings)
    findings = _findings(run, located, names, tables, outcomes, pictures, work)
    sections = [*segmentation_section(tables["segmentation"]), *answers.sections]
    findings = replace(findings, models=sorted(models), external=external, sections=sections)
    return _write(run, findings, tables | {"predictions": predictions}, models)


def _of_models(
    outcomes: list[Outcome],
    usable: pd.DataFrame,
    names: list[str],
    predictions: pd.DataFrame,
    tables: Tables,
    settings: StudySettings,
) -> Tables:
    """claims, dimensions, tuning."""
    importances = joined(outcome.importances for outcome in outcomes)
    offered = joined(outcome.offered for outcome in outcomes)
    return {
        "claims": claims(usable, predictions, importances, offered, tables, settings),
        "dimensions": dimensions(importances, offered, tables["subjects"], usable, len(names)),
        "tuning": tuned(joined(outcome.tuning for outcome in outcomes)),
    }


def _models(run: Run, usable: pd.DataFrame, names: list[str], manifest: pd.DataFrame) -> dict[str, bytes]:
    """name -> file: fitted to all subjects, under the reference and, where there are more, under all protocols."""
    settings, law = run.settings, run.tables.radiomics.localisation
    protocols = protocols_of(usable, settings.reference)
    sets = {settings.reference: protocols[:1]} | ({"all": protocols} if len(protocols) > 1 else {})
    learnt = {protocol.protocol: protocol for protocol in trained_on(manifest)}
    pixel_mm = learnt[settings.reference].pixel_mm
    templates = [compact(template, settings.region_px * pixel_mm, law) for template in run.templates]
    return {
        kept.name: pack(
            kept,
            templates,
            reads="linear",
            grade_names=class_names(kept.task),
            families=settings.families,
            backend=settings.backend,
            bins=settings.bins,
            pixel_mm=pixel_mm,
            region_px=settings.region_px,
            trained_on=tuple(learnt[protocol] for protocol in kept.trained_on),
            seed=settings.seed,
        )
        for kept in refitted(usable, names, settings, sets)
    }


def _require_enough(usable: pd.DataFrame, settings: StudySettings) -> None:
    of_reference = usable[usable["protocol"] == settings.reference]
    grades = sorted({int(grade) for grade in of_reference["grade"]})
    if not {0, 2} <= set(grades):
        raise InputError(
            f"grades with a region found under {settings.reference} = {grades}; allowed: 0 and 2 among them, with "
            "three subjects or more"
        )


def _findings(
    run: Run,
    located: pd.DataFrame,
    names: list[str],
    tables: Tables,
    outcomes: list[Outcome],
    pictures: dict[str, Picture],
    work_seconds: dict[str, float],
) -> Findings:
    usable, settings = located[located["status"] == "found"], run.settings
    keys = ["model", "selection", "feature"]
    importance = tables["importance"].merge(tables["permutation"][[*keys, "drop"]], on=keys, how="left")
    shown = importance[importance["selection"] == settings.selections[0]]
    counts = {name: int(located[column].nunique()) for name, column in _COUNTED.items()}
    within = tables["splits"][tables["splits"]["scenario"] == "within"]
    tested = within["test_subjects"]
    packages = (*_PACKAGES, *BACKENDS[settings.backend].libraries)
    return Findings(
        counts=counts | {"regions refused": len(located) - len(usable)},
        composition=composition(located),
        warnings=warnings_of(located),
        notes=notes_of(located),
        localisation=tables["localisation"],
        morphology=tables["morphology"],
        subgroups=tables["subgroups"],
        scores=tables["scores"],
        differences=tables["differences"],
        claims=tables["claims"],
        calibration=tables["calibration"],
        families=by_family(shown).join(by_family(shown, "drop").add_suffix(" drop")),
        screened=[outcome.stable for outcome in outcomes if outcome.stable is not None],
        stable=count_stable(tables["reliability"]),
        leading=shown.groupby("model", sort=False).head(5),
        degenerate=[name for name in names if is_degenerate(usable[name].to_numpy())],
        pictures=pictures,
        settings=asdict(settings),
        processing=processing(settings.region_px, settings.bins, settings.families),
        versions={"python": platform.python_version()} | {name: version(name) for name in packages},
        cost=cost_rows(run.execution.timer),
        work_seconds=work_seconds,
        workers=run.execution.workers,
        features=len(names),
        test_subjects=(int(tested.min()), int(tested.max())),
        test_rarest=int(within["test_rarest"].min()),
    )


def _write(run: Run, findings: Findings, tables: Tables, files: dict[str, bytes]) -> StudyResult:
    """Tables, pictures, models, study.json and the page; of two runs on one cohort and settings only times differ."""
    out, pictures = run.out, {}
    for name, picture in findings.pictures.items():
        pictures[name] = out / "pictures" / f"{name}.png"
        results.save_bytes(pictures[name], picture.png)
    written = {name: out / f"{name}.csv" for name in tables}
    for name, table in tables.items():
        results.save_table(written[name], table)
    models = {name: out / "models" / f"{name}{SUFFIX}" for name in sorted(files)}
    for name, path in models.items():
        results.save_bytes(path, files[name])
    facts = ["counts", "warnings", "notes", "features", "degenerate"]
    facts += ["settings", "processing", "versions", "cost", "workers"]
    results.save_json(out / "study.json", {name: getattr(findings, name) for name in facts})
    results.save_json(out / "environment.json", environment())
    results.save_text(out / "report.html", render(findings))
    results.save_json(out / "checklist.json", checklist(out, run.tables.guidelines))
    return StudyResult(
        report=out / "report.html",
        pictures=pictures,
        tables={"features": out / "features.csv", **written},
        models=models,
        scores=tables["scores"],
        differences=tables["differences"],
        reliability=tables["reliability"],
        localisation=tables["localisation"],
        seconds={row["stage"]: row["seconds"] for row in findings.cost},
    )
