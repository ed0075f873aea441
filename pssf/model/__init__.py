"""What users construct and get back.

knee        Knee, Osteophyte, draw_knee       parameters of a knee, checked at birth
protocol    Protocol, load_protocol           how a radiograph is taken
radiograph  Radiograph, Truth                 pixels and labels
"""
