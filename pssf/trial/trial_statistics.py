"""Statistics of a trial: measurement errors, responsiveness, subjects per arm, causes of error, and alignment."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from ..core.checks import Array
from ..data.analysis.trial_table import TrialDesign
from ..study.statistics.features.reliability import icc
from .trial_design import CAUSES
from .trial_measurement import MEASURES, TEXTURES

POWER = 0.8
LEVEL = 0.05
# Largest distance between the projections of both margins of an aligned medial plateau, in mm (Mazzuca et al. 2001).
ALIGNED_MM = 1.0
_RESAMPLES = 500
# Smallest number of knees from which an interval or a number of subjects is estimated (assumed).
_MIN_KNEES = 10
_PERCENTILES = (2.5, 97.5)
# Measures whose true value is the joint space of a compartment of the knee.
TRUE_MEASURES = {"medial_mm": "true_medial_mm", "lateral_mm": "true_lateral_mm"}
_COMPARTMENTS = {"lateral_mm": "lateral"}
MEASURE_COLUMNS = [
    *("view", "reader", "measure", "radiographs", "missing", "knees"),
    *("bias_true", "bias_projected", "bias_3d", "r_3d"),
    *(f"{name}{end}" for name in ("sem", "sdd", "icc", "srm") for end in ("", "_low", "_high")),
    *("change", "change_sd", "subjects_per_arm", "subjects_per_arm_low", "subjects_per_arm_high"),
    *("difference", "p"),
]
CAUSE_COLUMNS = [
    "view",
    "reader",
    "measure",
    "cause",
    "knees",
    "sd_all",
    "sd_without",
    "share",
    "share_low",
    "share_high",
]
ALIGNMENT_COLUMNS = [
    *("view", "radiographs", "aligned", "pairs", "aligned_twice", "reader"),
    *("loss_all", "loss_all_sd", "loss_aligned", "loss_aligned_sd"),
]


def summarise_measures(radiographs: pd.DataFrame, design: TrialDesign) -> pd.DataFrame:
    """Summarise error, reliability, responsiveness and sample size of every view, reader and measure.

    Parameters
    ----------
    radiographs : DataFrame
        One row per radiograph of the trial.
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    DataFrame
        Columns `MEASURE_COLUMNS`. Standard error of measurement ``sem``, smallest detectable difference ``sdd`` and
        ``icc`` come from the repeated radiographs of the first visit. Standardised response mean ``srm`` and
        ``subjects_per_arm`` come from the untreated knees at the last visit. ``difference`` is the mean change of
        treated minus untreated knees. Intervals are from a bootstrap of subjects.
    """
    own = radiographs[radiographs["without"] == ""]
    rows = [
        {"view": view, "reader": reader, "measure": measure, **_summarise(of_view, reader, measure, design)}
        for view, of_view in own.groupby("view", sort=False)
        for reader, measure in list_measures(radiographs, design)
    ]
    return pd.DataFrame(rows, columns=MEASURE_COLUMNS)


def list_measures(radiographs: pd.DataFrame, design: TrialDesign) -> list[tuple[str, str]]:
    """List the pairs of reader and measure of a trial; texture has the reader "image".

    Parameters
    ----------
    radiographs : DataFrame
        One row per radiograph of the trial.
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    list of tuple of str
        Reader and measure.
    """
    listed = [(reader, measure) for reader in design.readers for measure in MEASURES]
    return listed + [("image", name) for name in TEXTURES if name in radiographs]


def _summarise(table: pd.DataFrame, reader: str, measure: str, design: TrialDesign) -> dict[str, Any]:
    """Summarise one measure of one reader in one view."""
    column = measure if reader == "image" else f"{reader}_{measure}"
    errors = table[column] - table[TRUE_MEASURES[measure]] if measure in TRUE_MEASURES else None
    against = None if reader in ("label", "image") else (table[column] - table[f"label_{measure}"]).mean()
    repeats = _pivot_repeats(table, column)
    changes = _pivot_changes(table, column, design)
    untreated = changes[~changes["treated"]]
    treated = changes[changes["treated"]]
    fraction = design.treatment.fraction if _is_slowed(measure, design) else 0.0
    row: dict[str, Any] = {
        "radiographs": len(table),
        "missing": int(table[column].isna().sum()),
        "knees": len(repeats),
        "bias_true": np.nan if errors is None else errors.mean(),
        "bias_projected": np.nan if against is None else against,
        **_compare_with_distance(table, column, measure),
        "change": untreated["change"].mean(),
        "change_sd": untreated["change"].std(ddof=1),
    }
    row |= estimate_with_interval("sem", repeats, _compute_sem) | estimate_with_interval(
        "icc", repeats, lambda values: icc(values)[0]
    )
    row |= {f"sdd{end}": 1.96 * np.sqrt(2) * row[f"sem{end}"] for end in ("", "_low", "_high")}
    row |= estimate_with_interval("srm", untreated[["change"]], _compute_srm)
    row |= estimate_with_interval("subjects_per_arm", changes, lambda values: _compute_size(values, fraction))
    if min(len(treated), len(untreated)) > 1:
        row["difference"] = treated["change"].mean() - untreated["change"].mean()
        row["p"] = float(stats.ttest_ind(treated["change"], untreated["change"], equal_var=False).pvalue)
    return row


def _compare_with_distance(table: pd.DataFrame, column: str, measure: str) -> dict[str, float]:
    """Compare a minimum joint space with the minimal distance of the bones: mean difference and correlation."""
    distance = f"distance_{measure}"
    if measure not in TRUE_MEASURES or distance not in table:
        return {}
    known = table[[column, distance]].dropna()
    enough = len(known) >= _MIN_KNEES
    r = float(np.corrcoef(known[column], known[distance])[0, 1]) if enough else np.nan
    return {"bias_3d": (known[column] - known[distance]).mean(), "r_3d": r}


def _is_slowed(measure: str, design: TrialDesign) -> bool:
    """Return whether the treatment slows the change of a measure."""
    return design.treatment.compartment in ("both", _COMPARTMENTS.get(measure, "medial")) and measure in MEASURES


def _pivot_repeats(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """Arrange the repeated measurements of the first visit: one row per knee, indexed by subject and knee."""
    first = table[table["month"] == 0]
    return first.pivot(index=["subject", "knee"], columns="repeat", values=column).dropna()


def _pivot_changes(table: pd.DataFrame, column: str, design: TrialDesign) -> pd.DataFrame:
    """Compute the change from the first to the last visit of each knee: columns treated and change."""
    once = table[table["repeat"] == 0]
    index = ["subject", "knee", "treated"]
    wide = once.pivot(index=index, columns="month", values=column)
    months = design.visits_months
    if len(months) < 2 or months[-1] not in wide:
        return pd.DataFrame({"treated": np.zeros(0, bool), "change": np.zeros(0)})
    change = (wide[months[-1]] - wide[0.0]).dropna().to_frame("change").reset_index("treated")
    return change.assign(treated=change["treated"].astype(bool))[["treated", "change"]]


def _compute_sem(values: Array) -> float:
    """Compute the standard error of measurement: root of the mean variance of the repeats of a knee."""
    return float(np.sqrt(values.var(axis=1, ddof=1).mean()))


def _compute_srm(values: Array) -> float:
    """Compute the standardised response mean: mean of the change divided by its standard deviation."""
    spread = values.std(ddof=1)
    return float(values.mean() / spread) if spread > 0 else float("nan")


def _compute_size(values: Array, fraction: float) -> float:
    """Compute the number of knees per arm from (knees, 2): whether a knee is treated, and its change."""
    treated = values[:, 0] > 0
    untreated = values[~treated, 1]
    if len(untreated) < 2:
        return float("nan")
    sd = untreated.std(ddof=1)
    return compute_subjects_per_arm(
        fraction * untreated.mean(), sd, values[treated, 1].std(ddof=1) if treated.sum() > 2 else sd
    )


def compute_subjects_per_arm(effect: float, sd_untreated: float, sd_treated: float) -> float:
    """Compute the number of knees per arm for a power of 80 % in a two-sided Welch test at a level of 5 %.

    Parameters
    ----------
    effect : float
        Difference between the mean changes of both arms, in the unit of the measure.
    sd_untreated, sd_treated : float
        Standard deviations of the changes of each arm, in the same unit.

    Returns
    -------
    float
        Number of knees per arm, rounded up; infinite without an effect. The normal approximation is corrected for the
        t distribution (Guenther 1981).
    """
    if not abs(effect) > 0:
        return float("inf")
    level, power = stats.norm.ppf([1 - LEVEL / 2, POWER])
    needed = (level + power) ** 2 * (sd_untreated**2 + sd_treated**2) / effect**2 + level**2 / 4
    return float(np.ceil(needed))


def estimate_with_interval(name: str, table: pd.DataFrame, compute: Callable[[Array], float]) -> dict[str, float]:
    """Compute a statistic and its 95 % interval over bootstrap samples of the subjects.

    Parameters
    ----------
    name : str
        Name of the statistic.
    table : DataFrame
        One row per knee; the index has the level ``subject``.
    compute : callable
        Function that computes the statistic from the values of the table, (knees, columns).

    Returns
    -------
    dict of str to float
        Statistic under its name, and limits of its interval with ``_low`` and ``_high``; NaN for fewer than 10 knees.
    """
    values = table.to_numpy(np.float64)
    if len(values) < _MIN_KNEES:
        return {name: np.nan, f"{name}_low": np.nan, f"{name}_high": np.nan}
    drawn = [compute(values[places]) for places in _resample_subjects(table)]
    finite = [value for value in drawn if not np.isnan(value)]
    low, high = np.percentile(finite, _PERCENTILES, method="nearest") if finite else (np.nan, np.nan)
    return {name: compute(values), f"{name}_low": float(low), f"{name}_high": float(high)}


def _resample_subjects(table: pd.DataFrame) -> Iterator[Array]:
    """Yield the rows of bootstrap samples of the subjects, with all their knees."""
    subjects = table.index.get_level_values("subject").to_numpy()
    places = [np.flatnonzero(subjects == subject) for subject in np.unique(subjects)]
    rng = np.random.default_rng(0)
    for _ in range(_RESAMPLES):
        yield np.concatenate([places[number] for number in rng.integers(len(places), size=len(places))])


def decompose_errors(radiographs: pd.DataFrame, design: TrialDesign) -> pd.DataFrame:
    """Decompose the variance of repeated measurements into its causes.

    Parameters
    ----------
    radiographs : DataFrame
        One row per radiograph of the trial, including those without single causes.
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    DataFrame
        Columns `CAUSE_COLUMNS`. The share of a cause is the fraction by which the variance between repeated radiographs
        decreases without it. The share of the cause "reader" is the fraction by which the variance is smaller for the
        projected joint space. Shares need not sum to 1, because causes interact.
    """
    rows: list[dict[str, Any]] = []
    left_out = [cause for cause in CAUSES if (radiographs["without"] == cause).any()]
    first = radiographs[radiographs["month"] == 0]
    for view, of_view in first.groupby("view", sort=False):
        for reader, measure in list_measures(radiographs, design):
            column = measure if reader == "image" else f"{reader}_{measure}"
            whole = _pivot_repeats(of_view[of_view["without"] == ""], column)
            label = {"view": view, "reader": reader, "measure": measure}
            for cause in left_out:
                less = _pivot_repeats(of_view[of_view["without"] == cause], column)
                rows.append(label | {"cause": cause} | _compare_variances(whole, less))
            if reader in ("network", "human"):
                exact = _pivot_repeats(of_view[of_view["without"] == ""], f"label_{measure}")
                rows.append(label | {"cause": "reader"} | _compare_variances(whole, exact))
    return pd.DataFrame(rows, columns=CAUSE_COLUMNS)


def _compare_variances(whole: pd.DataFrame, less: pd.DataFrame) -> dict[str, float]:
    """Compare the variance of repeats of the same knees with and without a cause."""
    both = pd.concat([whole, less], axis=1, join="inner")
    count = whole.shape[1]

    def share(values: Array) -> float:
        """Return the fraction by which the variance is smaller without the cause."""
        before = values[:, :count].var(axis=1, ddof=1).mean()
        return float(1 - values[:, count:].var(axis=1, ddof=1).mean() / before) if before > 0 else float("nan")

    values = both.to_numpy(np.float64)
    known = len(both) >= _MIN_KNEES
    return {
        "knees": len(both),
        "sd_all": _compute_sem(values[:, :count]) if known else np.nan,
        "sd_without": _compute_sem(values[:, count:]) if known else np.nan,
        **estimate_with_interval("share", both, share),
    }


def summarise_alignment(radiographs: pd.DataFrame, design: TrialDesign) -> pd.DataFrame:
    """Summarise the alignment of the medial plateau with the beam, and the loss of joint space in aligned knees.

    Parameters
    ----------
    radiographs : DataFrame
        One row per radiograph of the trial.
    design : TrialDesign
        Design of the trial.

    Returns
    -------
    DataFrame
        Columns `ALIGNMENT_COLUMNS`: share of aligned radiographs, share of knees that are aligned at the first and the
        last visit, and mean annual loss of minimum medial joint space of untreated knees, in mm per year.
    """
    own = radiographs[(radiographs["without"] == "") & (radiographs["repeat"] == 0)]
    rows: list[dict[str, Any]] = []
    years = design.visits_months[-1] / 12
    for view, of_view in own.groupby("view", sort=False):
        aligned = of_view["inter_margin_mm"].abs() <= ALIGNED_MM
        for reader in design.readers:
            column = f"{reader}_medial_mm"
            pairs = _pivot_changes(of_view, column, design)
            twice = _pivot_changes(of_view.assign(**{column: of_view[column].where(aligned)}), column, design)
            loss, loss_aligned = (
                -changes.loc[~changes["treated"], "change"] / years if years else changes["change"]
                for changes in (pairs, twice)
            )
            rows.append(
                {
                    "view": view, "radiographs": len(of_view), "aligned": aligned.mean(), "pairs": len(pairs),
                    "aligned_twice": len(twice) / len(pairs) if len(pairs) else np.nan, "reader": reader,
                    "loss_all": loss.mean(), "loss_all_sd": loss.std(ddof=1),
                    "loss_aligned": loss_aligned.mean(), "loss_aligned_sd": loss_aligned.std(ddof=1),
                }
            )  # fmt: skip
    return pd.DataFrame(rows, columns=ALIGNMENT_COLUMNS)
