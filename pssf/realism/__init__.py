"""realism.contours.compare  landmarks of drawn knees, people's -> means, spreads, modes and gaps side by side
realism.bones.compare  given bones, built and drawn ones -> how far off, and how varied, by one measure

surfaces  similarity fit and distance of two meshes           bone_fit      where a bone lies on another of its kind
shape_fit      real bones -> data/shapes.toml, by             freeform_fit  a lattice fitted to a surface
shape_frames   real bones in the frames of the mean man's      shape_modes   how the bones of a knee differ together
shape_measures, shape_names  what modes are called by          shape_report  how near bones come, spread, folds
contour_figure, bone_figure, shape_figure  the pictures       (extra "study")
"""
