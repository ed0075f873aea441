"""Tables of knees: field definitions, grade tables, OARSI and KL thresholds, progression and cohort presets."""
