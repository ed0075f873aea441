"""Location error of the medial joint line, and number of radiographs without a located joint."""

import numpy as np
import pandas as pd

# Threshold of a gross localisation error, in mm: about one joint space width. If the error is larger, the region is at
# another anatomical site.
GROSS_ERROR_MM = 5.0


def add_localisation_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Add the distance between the located and the true medial joint line to a table of radiographs.

    Parameters
    ----------
    table : DataFrame
        Radiographs: row_px, col_px (located), truth_medial_row_px, truth_medial_col_px (true), pixel_mm, sdd_mm,
        sod_mm.

    Returns
    -------
    DataFrame
        The table with error_px (in the image), and error_mm, error_row_mm, error_col_mm (in mm at the joint plane).
    """
    rows = table["row_px"] - table["truth_medial_row_px"]
    cols = table["col_px"] - table["truth_medial_col_px"]
    error_px = np.hypot(rows, cols)
    magnification = table["sdd_mm"] / table["sod_mm"]
    per_px_mm = table["pixel_mm"] / magnification
    return table.assign(
        error_px=error_px, error_mm=error_px * per_px_mm, error_row_mm=rows * per_px_mm, error_col_mm=cols * per_px_mm
    )


def summarise_localisation(table: pd.DataFrame) -> pd.DataFrame:
    """Summarise the localisation errors per protocol and grade, and over all radiographs.

    Parameters
    ----------
    table : DataFrame
        Radiographs from `add_localisation_errors`, with protocol, grade, score and status.

    Returns
    -------
    DataFrame
        One row per protocol and grade, and one row for all radiographs. Columns: number of radiographs; number of
        radiographs without a located region, by cause; mean and 95th percentile of the error; mean error along rows and
        columns; number of errors above 5 mm; lowest template-matching score.
    """
    rows = [
        {"protocol": protocol, "grade": str(grade), **_summarise_errors(part)}
        for protocol, of_protocol in table.groupby("protocol", sort=False)
        for grade, part in of_protocol.groupby("grade")
    ]
    return pd.DataFrame([*rows, {"protocol": "all", "grade": "all", **_summarise_errors(table)}])


def _summarise_errors(part: pd.DataFrame) -> dict[str, float]:
    """Summarise the localisation errors of one group of radiographs."""
    accepted = part[part["status"] == "found"]
    return {
        "radiographs": len(part),
        "rejected": int((~part["status"].isin(["found", "leaves image"])).sum()),
        "leaves_image": int((part["status"] == "leaves image").sum()),
        "mean_px": accepted["error_px"].mean(),
        "p95_px": accepted["error_px"].quantile(0.95),
        "mean_mm": accepted["error_mm"].mean(),
        "p95_mm": accepted["error_mm"].quantile(0.95),
        "row_bias_mm": accepted["error_row_mm"].mean(),
        "col_bias_mm": accepted["error_col_mm"].mean(),
        "gross_errors": int((accepted["error_mm"] > GROSS_ERROR_MM).sum()),
        "lowest_score": part["score"].min(),
    }
