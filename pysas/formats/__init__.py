"""Files: read, checked and written. No algorithm stands here."""
