"""Define the section introductions and table captions of the comparison page."""

CONTOURS_TEXT = (
    "Sixteen contour landmarks of every simulated knee are compared with manual landmarks on 748 patient radiographs "
    "(PA, fixed flexion; Tiulpin et al. 2019). Coordinates are fractions of the plateau width, which removes size. A "
    "mean is within tolerance if it differs from the patient mean by at most half a patient standard deviation. A "
    "standard deviation is within tolerance if it is 0.7 to 1.4 times the patient standard deviation. The landmarks of "
    "each simulated knee come from one sampled acquisition with the protocol named above, or from the selected cohort."
)
BONES_TEXT = (
    "Bones without osteophytes are registered by a similarity transform (rotation, translation, scale). Distances are "
    "measured between the surfaces in both directions, at the mean size of the patient bones. The flat cut of the "
    "shafts is excluded. The bone of the default knee, called the built mean, is compared with the mean patient bone. "
    "Two spreads are also reported: the distances of the patient bones from the mean patient bone, and the distances "
    "of the sampled bones from the bone of the default knee."
)
FILMS_TEXT = (
    "Every radiograph, patient or simulated, is normalised: the joint is localised, left knees are mirrored, and the "
    "image is scaled to a plateau width of 78 mm, a pixel pitch of 0.46 mm and a field of 92 by 77 mm. Grey values "
    "between the 1st and 99th percentiles are scaled to 8 bits. Simulated radiographs are first downsampled to the "
    "pixel sizes of the largest patient source. Bone contours are traced, and groups of features are measured. Models "
    "are logistic regressions (L2) on standardised features. Intervals are 95 % bootstrap intervals over subjects, "
    "with fixed models. They cover the sampling of the test radiographs only, and are wide for few radiographs."
)
CAPTIONS = {
    "domains": "(a) Source separability: AUC of patient against simulated radiographs, and between patient sources as "
    "a control. With an AUC of 0.5, two sources are indistinguishable; with an AUC of 1, they are always "
    "distinguished.",
    "transfer": "(b) Grade prediction on patient radiographs by classifiers that are trained on simulated radiographs "
    "(auc) or, with cross-validation, on patient radiographs (patient_auc). gain_fraction is the gain over chance "
    "(AUC - 0.5) from simulated radiographs, divided by the gain from patient radiographs. gain_fraction is empty if "
    "the gain from patient radiographs is uncertain.",
    "effects": "(c) Standardised differences between grades, compared between patient and simulated radiographs over "
    "the features of a group: correlation r and fraction of equal signs. max_r is the expected r if the true "
    "differences are equal.",
    "ratios": "(d) Outline ratios as fractions of the plateau width, for all radiographs of a patient source "
    "(patients) and for simulated radiographs (simulated). Sources with different views differ because of the view.",
    "tone": "(d) Grey values after display processing: tissue contrasts and, if the image shows the shaft, grey values "
    "relative to soft tissue (0) and shaft cortex (1). The table also has the mean grey value around the joint, and "
    "the offset of the joint from the image centre (mm at the joint), which depends on cropping.",
    "edges": "(d) Grey profile across the medial and lateral bone edges, by depth in mm from the steepest point "
    "inwards. Soft tissue is 0 and bone at 6 to 12 mm depth is 1. The table also has the contrast of the strongest "
    "physeal line, divided by the spread of the line-filter response.",
    "fine": "(d) Texture at the original pixel pitch, for radiographs with pixel pitches up to 0.25 mm.",
    "form": "(d) Texture of normalised radiographs at 0.2 to 0.8 cycles/mm.",
}
