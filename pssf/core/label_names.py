"""Names of the contour landmarks and positions of JSW(x), as used for labels and by the reader of radiographs."""

# Order and names follow the annotations of Tiulpin et al. 2019 (KNEEL, arXiv 1907.12237), from lateral to medial.
TIBIAL_LANDMARKS = (
    "tibia_lateral_edge", "tibia_lateral_1", "tibia_lateral_2", "lateral_spine", "between_spines",
    "medial_spine", "tibia_medial_2", "tibia_medial_1", "tibia_medial_edge",
)  # fmt: skip
FEMORAL_LANDMARKS = (
    "femur_lateral_edge", "femur_lateral_condyle", "femur_lateral_notch", "notch_top",
    "femur_medial_notch", "femur_medial_condyle", "femur_medial_edge",
)  # fmt: skip
CONTOUR_LANDMARKS = TIBIAL_LANDMARKS + FEMORAL_LANDMARKS
# Positions x at which JSW(x) is measured, as fractions of the femoral width from the medial edge (Neumann et al. 2009).
# The femoral width corresponds to CFWDTH in the tables of the Osteoarthritis Initiative. It is measured between the
# epicondyles, because osteophytes do not change their positions (assumed). With this width, the fractions cover the
# range of the search for the minimum JSW.
JSW_FRACTIONS = (0.15, 0.175, 0.2, 0.225, 0.25, 0.275, 0.3, 0.7, 0.725, 0.75, 0.775, 0.8, 0.825, 0.85, 0.875, 0.9)
