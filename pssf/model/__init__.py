"""What users construct and get back.

knee        Knee, Osteophyte, Cyst            parameters of a knee, checked at birth
draw, severity, advanced  draw_knee           a knee of a grade, by a table of grades
progress    progress, true_change             the same knee some years later
oarsi, kellgren_lawrence, axes                grades and angles of what a knee is built with
protocol    Protocol, load_protocol           how a radiograph is taken
radiograph  Radiograph, Truth                 pixels and labels
"""
