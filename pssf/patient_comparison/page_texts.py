"""Texts of the comparison page: introduction of each section and table captions."""

CONTOURS_TEXT = (
    "Sixteen contour landmarks of every simulated knee are compared with manual landmarks on 748 patient radiographs "
    "(PA, fixed flexion; Tiulpin et al. 2019). Coordinates are fractions of the plateau width, which removes size. A "
    "mean is within tolerance if it differs from the patient mean by at most half a standard deviation of patients. A "
    "standard deviation is within tolerance at 0.7 to 1.4 times that of patients. Each simulated knee has one sampled "
    "acquisition under the protocol named above, or its radiographs in the given cohort."
)
BONES_TEXT = (
    "Bones without osteophytes are registered by a similarity transform (rotation, translation, scale). Distances are "
    "measured between the surfaces in both directions, at the mean size of the patient bones. The flat cut of the "
    "shafts is excluded. Spread is the distance of each patient bone from the mean patient bone, and of each sampled "
    "bone from the built mean bone."
)
FILMS_TEXT = (
    "Every radiograph, patient or simulated, is normalised: the joint is localised, left knees are mirrored, and the "
    "image is scaled to a plateau width of 78 mm, a pitch of 0.46 mm, a field of 92 by 77 mm, and 8 bits between the "
    "1st and 99th percentile. Simulated radiographs are first reduced to the pixel sizes of the largest patient "
    "source. Bone contours are traced, and groups of features are measured. Models are logistic regressions (L2) on "
    "standardised features. Intervals are 95 % bootstrap intervals over subjects, with fixed models. They cover the "
    "sampling of the test radiographs only, and are wide if there are few radiographs."
)
CAPTIONS = {
    "domains": "(a) Source separability: AUC of patient against simulated radiographs, and between patient sources as "
    "a control. 0.5 means indistinguishable, 1 means always distinguished.",
    "transfer": "(b) Grade prediction on patient radiographs, trained on simulated radiographs (auc) and on patient "
    "radiographs by cross-validation (patient_auc). gain_fraction is the gain over chance (AUC - 0.5) from "
    "simulated radiographs, divided by the gain from patient radiographs. It is empty if the latter is uncertain.",
    "effects": "(c) Standardised grade differences of patient and simulated radiographs, over the features of a group: "
    "correlation r and fraction of equal signs. max_r is the expected r if the true differences are equal.",
    "ratios": "(d) Outline ratios as fractions of the plateau width, for all radiographs of a patient source "
    "(patients) and for simulated radiographs (simulated). Sources with different views differ because of the view.",
    "tone": "(d) Grey values as displayed: tissue contrasts and, if the image shows the shaft, grey values relative to "
    "soft tissue (0) and shaft cortex (1). Also the offset of the joint from the image centre (mm at the joint; it "
    "depends on cropping) and the mean grey value around the joint.",
    "edges": "(d) Grey profile across the medial and lateral bone edges, by depth in mm from the steepest point "
    "inwards. Soft tissue is 0 and bone at 6 to 12 mm depth is 1. Also the contrast of the strongest physeal line, "
    "divided by the spread of the line-filter response.",
    "fine": "(d) Texture at the original pixel pitch, for radiographs with pitches up to 0.25 mm.",
    "form": "(d) Texture of normalised radiographs, 0.2 to 0.8 cycles/mm.",
}
