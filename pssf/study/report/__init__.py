"""Report of a study: figures, summary, checklist, environment and the HTML page."""
