"""Sections of the report that consist of sentences, figures and one table."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from ..design.response_curve_design import ProtocolAxis
from ..design.sensitivity_plan import PARAMETER_SPACE
from ..learn.confounded_training import CONFOUNDERS
from ..learn.incremental_value import JSW_MEASUREMENT_SD_MM, PREDICTOR_SETS
from ..statistics.analyses.incremental_value_scores import BEST_POSSIBLE
from ..statistics.analyses.learning_curves import TARGET_POWER
from ..statistics.scores.claims import UNDECIDED
from .cell_formats import MISSING, format_fixed, format_interval, format_signed
from .figures import incremental_value_figures, response_curve_figures
from .report_elements import Picture, Section
from .undecided_tables import explain_undecided_intervals

# Reasons why a table is collapsed.
_NO_ANSWER = "No question is answered: every corrected p is 0.05 or more, or the test sets have too few subjects."
_NO_BREAKPOINT = "No breakpoint can be determined: there are too few test subjects, or the AUC is at chance level."


def make_segmentation_section(table: pd.DataFrame) -> list[Section]:
    """Make the section on the accuracy of the bone segmentation.

    Parameters
    ----------
    table : DataFrame
        Table from `segmentation_accuracy.evaluate_segmentation`.

    Returns
    -------
    list of Section
        One section; empty if the table is empty.
    """
    if table.empty:
        return []
    shown = [
        {
            "Grade": row["grade"],
            "Radiographs": row["radiographs"],
            "Dice": format_fixed(row["dice"]),
            "Dice, 5th percentile": format_fixed(row["dice_p5"]),
            "Mean outline distance, mm": format_fixed(row["mean_mm"]),
            "95th percentile, mm": format_fixed(row["p95_mm"]),
            "Area, segmented / true": format_fixed(row["area"]),
        }
        for row in table.to_dict("records")
    ]
    return [
        Section(
            name="bone",
            title="Segmentation accuracy",
            sentences=(
                "Shape features are measured on the segmented bone. The table compares the segmented bone with the "
                "projection of all bones, including osteophytes, in the regions of the repeat radiographs. If they "
                "differ much, a shape feature describes a threshold contour of the signal and not the outline of bone.",
            ),
            table=pd.DataFrame(shown),
            files=("segmentation.csv",),
            note="Distances are symmetric outline distances, in mm at the joint plane.",
        )
    ]


def make_incremental_value_section(aucs: pd.DataFrame, differences: pd.DataFrame, subjects: int) -> Section:
    """Make the section on the incremental predictive value.

    Parameters
    ----------
    aucs : DataFrame
        AUC of each predictor set, as for `incremental_value_figures.draw_incremental_value`.
    differences : DataFrame
        Paired AUC differences between predictor sets.
    subjects : int
        Number of subjects in the cohort.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="incremental_value",
        png=incremental_value_figures.draw_incremental_value(aucs, differences),
        alt="AUC of grade 0 vs each other grade by predictor set, and paired differences",
        caption="Top: AUC of logistic regression by predictor set, mean over the splits with 95 % interval. Dashed "
        "line: best possible AUC, a lower bound from all parameters of newly sampled knees. Bottom: paired AUC "
        "differences on the same splits.",
    )
    shown = [
        {
            "Question": row["question"],
            "Grades": row["grades"],
            "AUC difference": format_signed(row["difference"]),
            "95 % interval": format_interval(row["low"], row["high"], signs=True),
            "p (Holm)": format_fixed(row["p_holm"], 3),
            "Answer": row["answer"],
        }
        for row in differences.to_dict("records")
    ]
    best = aucs[aucs["predictor_set"] == BEST_POSSIBLE]
    best_knees = f" ({int(best['knees'].iloc[0])} knees per pair of grades, cross-validation)" if len(best) else ""
    return Section(
        name="incremental_value",
        title="Incremental predictive value",
        sentences=(
            "Logistic regression is trained and tested on the same splits with different predictor sets: "
            f"{', '.join(PREDICTOR_SETS.values())}. Measured JSW is true JSW plus a measurement error of "
            f"{JSW_MEASUREMENT_SD_MM} mm (Mazzuca 1999) in each compartment. JSW is always a predictor and only "
            "features are selected, so the differences show the incremental value of the features.",
            "Apart from trabecular texture, an image cannot predict the grade better than the true parameters of a "
            f"knee. The best possible AUC is estimated by a fit to newly sampled knees{best_knees}; it is a lower "
            f"bound. If the AUC of the true parameters is lower, {subjects} subjects are too few for training.",
        ),
        table=pd.DataFrame(shown),
        note="An answer is yes or no if the corrected p is below 0.05 and there are enough test subjects. The answer "
        "'no' means that the first predictor set in the question has a lower AUC.",
        files=("incremental_value.csv", "incremental_value_differences.csv"),
        undecided="" if (differences["answer"] != UNDECIDED).any() else _NO_ANSWER,
        pictures=(picture,),
    )


def make_learning_section(curves: pd.DataFrame, power: pd.DataFrame) -> Section:
    """Make the section on sample size and power.

    Parameters
    ----------
    curves : DataFrame
        Table from `learning_curves.compute_learning_curves`.
    power : DataFrame
        Table from `learning_curves.tabulate_power`.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="learning",
        png=incremental_value_figures.draw_learning_curves(curves, power),
        alt="AUC against the number of training subjects, and power against the size of a cohort, by pair of grades",
        caption="Top: AUC against the number of training subjects. The test subjects of a split are always the same, "
        "so only the training set changes. Bottom: power to detect the AUC difference from measured JSW, against the "
        "number of subjects in a cohort. Dot: this cohort. Band: interval due to the uncertainty of the variance.",
    )
    shown = [
        {
            "Question": row["question"],
            "Grades": row["grades"],
            "Subjects in this cohort": row["subjects"],
            "Power with this cohort": format_fixed(row["power"]),
            f"Subjects for a power of {TARGET_POWER}": format_fixed(row["required_subjects"], 0),
            "95 % interval": format_interval(row["required_subjects_low"], row["required_subjects_high"], 0),
        }
        for row in power.to_dict("records")
    ]
    difference = f"{power['difference'].iloc[0]:g}" if len(power) else "the set value"
    return Section(
        name="learning",
        title="Sample size and power",
        sentences=(
            "The learning curves show how the AUC of a classifier depends on the number of training subjects. The "
            f"power is the probability of detecting an AUC difference of {difference} with the two-sided paired test "
            "of this report at a significance level of 5 %. The variance of a difference is assumed to be "
            "proportional to 1 / subjects.",
        ),
        table=pd.DataFrame(shown),
        note="Numbers of subjects include training, validation and test subjects of the two grades. The gain in AUC "
        "per step and its interval are in learning.csv, and the standard errors are in power.csv.",
        files=("learning.csv", "power.csv"),
        pictures=(picture,),
    )


def make_response_curves_section(
    tables: Mapping[str, pd.DataFrame],
    breaks: pd.DataFrame,
    axes: Mapping[str, ProtocolAxis],
    leading: Sequence[str],
    knees: int,
    task: str,
) -> Section:
    """Make the section on the response curves of features and models.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        Rows of the response curves, by name: "curve_<axis>".
    breaks : DataFrame
        Table from `breakpoints.find_breakpoints`.
    axes : mapping of str to ProtocolAxis
        Axes by name.
    leading : sequence of str
        Names of the features that are shown individually.
    knees : int
        Number of knees with response curves.
    task : str
        Classification task for which the knees with response curves are imaged.

    Returns
    -------
    Section
        Section with one figure per axis and one table.
    """
    pictures = [
        Picture(
            name=f"curve_{name}",
            png=response_curve_figures.draw_response_curves(
                tables[f"curve_{name}"], breaks[breaks["axis"] == name], axis, leading, task
            ),
            alt=f"Feature change, feature ICC, threshold shift and AUC against {axis.label}",
            caption=f"{axis.label[0].upper()}{axis.label[1:]}. From left to right: change of the most important "
            "features; ICC(2,1) of these features with the unchanged protocol; shift of the decision threshold, in log "
            "odds; AUC. Orange: breakpoints in the table, with their intervals. Dotted line: unchanged protocol.",
        )
        for name, axis in axes.items()
    ]
    shown = [
        {
            "Axis": row["axis"].replace("_", " "),
            "Conclusion": row["conclusion"],
            **_describe_breakpoint(row),
            "Measured range": f"{row['range_low']:.3g} to {row['range_high']:.3g}",
        }
        for row in breaks.to_dict("records")
    ]
    return Section(
        name="curves",
        title="Response curves",
        sentences=(
            f"{knees} knees with grade {task} are imaged again while one protocol parameter is changed in steps. The "
            "noise of each image is independent. The first model with the first feature selection is trained on the "
            "unchanged protocol. In every split it is tested on half of the knees, which are not used in training.",
            "The breakpoint of a conclusion is the first step, counted from the unchanged protocol, at which the "
            "conclusion fails. For the median ICC, its interval is computed from bootstrap samples of subjects. For "
            "the loss of AUC, its interval extends between the steps at which the limits of the 95 % interval of the "
            "loss cross the allowed loss.",
        ),
        table=pd.DataFrame(shown),
        files=("breakpoints.csv", *(f"curve_{name}.csv" for name in axes)),
        undecided="" if (breaks["result"] != UNDECIDED).any() else _NO_BREAKPOINT,
        note="Breakpoint: first step at which the conclusion fails, below or above the unchanged protocol.",
        pictures=pictures,
    )


def make_sensitivity_section(
    sobol_indices: pd.DataFrame,
    sensitivities: pd.DataFrame,
    leading: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
) -> Section:
    """Make the section on the sensitivity of features to knee and protocol parameters.

    Parameters
    ----------
    sobol_indices : DataFrame
        Table from `sensitivity_analysis.compute_sobol_indices`.
    sensitivities : DataFrame
        Table from `sensitivity_analysis.merge_sensitivity_tables`.
    leading : sequence of str
        Most important features of the models.
    bounds : mapping of str to tuple of float
        Lower and upper bound of each parameter, in the unit of the parameter.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="sensitivity",
        png=response_curve_figures.draw_sensitivity(sobol_indices, sensitivities, leading),
        alt="Total Sobol indices of parameter groups for the most important features, and slopes against correlations",
        caption="Left: total Sobol index of each parameter group for the most important features: the fraction of "
        "variance that the group explains alone and in interactions (Sobol 1993). Right: slope with fixed noise "
        "against correlation, one point per feature and parameter. On the drawn line, slope and correlation are equal.",
    )
    part = sensitivities[sensitivities["feature"].isin(leading)].dropna(subset="slope")
    strongest = part.assign(size=part["slope"].abs()).sort_values("size", ascending=False, kind="stable")
    shown = [
        {
            "Feature": row["feature"],
            "Parameter": row["parameter"],
            "Slope, SD per SD": format_signed(row["slope"]),
            "95 % interval": format_interval(row["slope_low"], row["slope_high"], signs=True),
            "Correlation": format_signed(row["rho"]),
            "Correlation within grades": format_signed(row["rho_within"]),
        }
        for row in strongest.groupby("feature", sort=False).head(2).to_dict("records")
    ]
    spans = "; ".join(f"{PARAMETER_SPACE[name].label}: {low:.3g} to {high:.3g}" for name, (low, high) in bounds.items())
    samples = f" from {int(sobol_indices['samples'].max())} samples" if len(sobol_indices) else ""
    return Section(
        name="sensitivity",
        title="Sensitivity analysis",
        sentences=(
            f"Sobol indices for knee and protocol parameters are computed with SALib{samples}, with 95 % intervals. A "
            "slope is computed from the feature change if one knee parameter changes by a tenth of its range. All "
            "other parameters and the noise are fixed. A correlation over the cohort also contains associations that "
            "arise because both the feature and the parameter depend on the grade.",
            f"Parameter ranges: {spans}.",
        ),
        table=pd.DataFrame(shown),
        files=("feature_parameter_correlations.csv", "slopes.csv", "sobol_indices.csv"),
        undecided=explain_undecided_intervals(part, "slope_low", "slope_high", bound=0.0),
        note="The table shows the two strongest slopes of each of the most important features. The CSV files contain "
        "all slopes and correlations, and the first-order and total Sobol indices.",
        pictures=(picture,),
    )


def make_confounders_section(table: pd.DataFrame) -> Section:
    """Make the section on the effects of confounders.

    Parameters
    ----------
    table : DataFrame
        Table from `confounding_effects.estimate_confounding`.

    Returns
    -------
    Section
        Section with one figure and one table.
    """
    picture = Picture(
        name="confounders",
        png=incremental_value_figures.draw_confounders(table),
        alt="AUC against the strength of the association of age, BMI or site with grade, naive and adjusted",
        caption="AUC for grade 0 vs 2 against the strength of the association in training, mean over the splits with "
        "95 % interval. Confounded test set: the association is the same as in training. Balanced test set: there is "
        "no association.",
    )
    strongest = table[table["strength"] == table["strength"].max()]
    shown = [
        {
            "Confounder": CONFOUNDERS[row["confounder"]],
            "Strength": f"{row['strength']:g}",
            "Measure": row["measure"],
            "AUC or difference": format_fixed(row["value"]),
            "95 % interval": format_interval(row["low"], row["high"]),
        }
        for row in strongest.to_dict("records")
    ]
    return Section(
        name="confounders",
        title="Confounders by design",
        sentences=(
            "At strength s, a fraction (1 + s)/2 of the training subjects with grade 2 is above the median age or "
            "BMI, or is imaged under the second protocol. The same fraction of the subjects with grade 0 is below the "
            "median, or is imaged under the reference protocol. The number of subjects does not depend on s. Test "
            "subjects are weighted so that the association is present or absent. For the adjusted model, the effect of "
            "the confounder on each feature is fitted within each grade of the training subjects by least squares, and "
            "is then subtracted.",
        ),
        table=pd.DataFrame(shown),
        files=("confounders.csv",),
        undecided=explain_undecided_intervals(strongest, "low", "high"),
        note="The table shows the strongest association; confounders.csv contains all strengths and p-values. Age "
        "affects an image only through thinner trabeculae. Any other gain with age is due to variables associated "
        "with age and grade in this cohort, or to chance.",
        pictures=(picture,),
    )


def _describe_breakpoint(row: Mapping[str, Any]) -> dict[str, str]:
    """Describe a breakpoint and its interval; a value outside the measured range is shown as the exceeded limit."""
    low, high = row["range_low"], row["range_high"]
    if row["result"] == UNDECIDED:
        return {"Breakpoint": UNDECIDED, "95 % interval": MISSING}

    def place(value: float) -> str:
        """Format a value, or the exceeded limit if the value is outside the measured range."""
        return f"{value:.3g}" if low <= value <= high else f"beyond {low if value < low else high:.3g}"

    ends = list(dict.fromkeys(place(end) for end in (row["low"], row["high"])))
    value = f"{row['side']} {place(row['value'])}" if low <= row["value"] <= high else "none in the measured range"
    return {"Breakpoint": value, "95 % interval": " to ".join(ends)}
