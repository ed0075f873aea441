"""Tables of the analyses: reference values, localisation, landmarks, IBSI, reporting guidelines, benchmark."""
