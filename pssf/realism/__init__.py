"""realism.contours.compare  landmarks of drawn knees, people's -> means, spreads, modes and gaps side by side
realism.bones.compare  given bones, built and drawn ones -> how far off, and how varied, by one measure

surfaces  similarity fit and distance of two meshes
contour_figure, bone_figure  the pictures       (extra "study")
"""
