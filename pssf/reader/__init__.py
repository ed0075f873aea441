"""Read landmarks, joint space and bone masks on frontal radiographs, with networks that were trained on simulations.

knee_frame      position, size, rotation and side of a knee; crops in its frame
networks        networks in ONNX format, and positions from heat maps
knee_finder     knees on a radiograph
side_decision   right or left knee
joint_measures  joint space widths and joint-line convergence from landmarks
reader_table    mean shape and thresholds
knee_reading    networks and thresholds, and reading of the knees on a radiograph
reading_rows    table rows of readings
film_overlay    pictures of readings
film_reading    reading of a file or an array, with its picture
landmark_agreement  comparison with annotated landmarks
"""
