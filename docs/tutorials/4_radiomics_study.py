r"""
4. The radiomics study and its report
=====================================

In this lesson you run a small radiomics study and read its report. The study has 8 knees and two families of
features, so this page is built in one or two minutes. The study is too small for valid results. **For the full size,
run a command of the last section.**
"""

# %%
# What a study does
# -----------------
#
# A study makes a cohort, finds the medial joint line in every radiograph, measures radiomic features of a region at
# the joint line, trains and tests models, and writes tables and a report. Data are split by subject, so both knees of
# a subject are in the same set.
#
# Run the study
# -------------
#
# ``make_experiment`` makes the radiographs, ``run_experiment`` runs the study. ``knees`` are the numbers of knees of
# grade 0, 1 and 2. Omitted components need no run time. This example has one protocol, one feature selection and one
# classifier.

# sphinx_gallery_thumbnail_path = 'validation/tables/robustness.png'
import re
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from pssf.core.processes.execution import Execution
from pssf.experiment import make_experiment, run_experiment

MATRIX = 512
work = Path(tempfile.mkdtemp())
execution = Execution(workers=1)
experiment = make_experiment(
    work,
    execution,
    {
        "preset": "quick",
        "knees": [4, 0, 4],
        "protocols": ["reference"],
        "matrix": MATRIX,
        "retested": 0,
        "repeats": 3,
        "families": ["firstorder", "shape2D"],
        "selections": ["l1"],
        "models": ["lr"],
        "replicates": 100,
    },
)
result = run_experiment(experiment, execution)
print("report:", result.report.name)

# %%
# Output of the study
# -------------------
#
# The output folder contains the report, one CSV file per table, and the figures. Every column is described in
# :doc:`/reference/columns`.

for _, path in sorted(result.tables.items()):
    print(f"{path.name:32}", *list(pd.read_csv(path, nrows=0).columns)[:5], "...")

# %%
# Localisation of the joint
# -------------------------
#
# The true position of the joint line is known, so the localisation error can be measured. The models do not use the
# true position.

print(result.localisation.iloc[:, :8].to_string())

# %%
# Scores
# ------
#
# Each row is one arm: task, training and test protocol, classifier and selection. The 95 % intervals come from the
# variation over the splits. With so few subjects, the intervals are wide or missing.

columns = ["task", "trained_on", "tested_on", "model", "selection", "auc", "auc_low", "auc_high", "test_subjects"]
print(result.scores[columns].head(6).round(2).to_string())

# %%
# Features and parameters
# -----------------------
#
# In a simulator, all parameters of every knee are known. The next table lists the strongest correlations between
# features and parameters.

follows = pd.read_csv(next(path for path in result.tables.values() if "correlations" in path.name))
strongest = follows.reindex(follows["rho"].abs().sort_values(ascending=False).index)
print(strongest.head(8).round(2).to_string(index=False))

# %%
# The report
# ----------
#
# ``report.html`` is one page that needs no network. The next lines list its sections. :doc:`/explanation/statistics`
# explains how intervals are computed and how claims are decided.

text = result.report.read_text(encoding="utf-8")
for heading in re.findall(r"<h2[^>]*>(.*?)</h2>", text, re.DOTALL):
    print("-", re.sub(r"<[^>]+>", "", heading).strip())

# %%
# The figures of the report are also PNG files. The following figure shows the importance of the features:

print(*sorted(result.pictures))
figure, axis = plt.subplots(figsize=(8, 5), layout="constrained")
axis.imshow(plt.imread(result.pictures["importance" if "importance" in result.pictures else min(result.pictures)]))
axis.set_axis_off()

# %%
# The full size
# -------------
#
# On the command line, ``quick`` has 24 knees under three protocols and takes some minutes. ``paper`` has the 780
# radiographs of the paper. ``population`` has 250 subjects with KL grades 0 to 4:
#
# .. code-block:: console
#
#    $ pssf study --preset quick --out runs/quick
#    $ pssf study --preset paper --out runs/paper
#    $ pssf study --preset population --out runs/population
#
# :doc:`/how_to/study_settings_file` describes all other settings. Repeat a command to continue a run that was
# stopped.
