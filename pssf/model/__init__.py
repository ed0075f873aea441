"""What users construct and get back.

knee        Knee, Osteophyte                  parameters of a knee, checked at birth
draw, severity  draw_knee                     a knee of a grade, by a table of grades
protocol    Protocol, load_protocol           how a radiograph is taken
radiograph  Radiograph, Truth                 pixels and labels
"""
