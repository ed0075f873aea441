"""Simulate a virtual trial: measurement errors of the joint space, their causes, and the number of subjects.

load_trial_design   design file -> TrialDesign
make_trial          TrialDesign -> tables and report
count_subject_jobs  TrialDesign -> number of subjects to simulate, including those without single causes of error

trial_design       checks of a design, and causes of measurement error
trial_plan         subjects with their course, and the radiographs of every visit
trial_measurement  simulation and measurement of the radiographs of a subject
trial_run          resumable run over all subjects
trial_statistics   errors, responsiveness, subjects per arm, causes and alignment
trial_power        check of the planned power by many trials
trial_report       report
jsw_error          error of the joint space against beam angle and positioning
jsw_error_figure   map of this error
"""

from .trial_design import load_trial_design
from .trial_maker import make_trial
from .trial_run import count_subject_jobs

__all__ = ["count_subject_jobs", "load_trial_design", "make_trial"]
