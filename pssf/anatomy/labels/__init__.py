"""Labels of a simulated radiograph: JSW, landmarks, osteophyte and cyst meshes, and labels after surgery."""
