"""Tables of the anatomy: template bones, shape model, soft tissue, trabecular bone, tissues and limb sizes."""
