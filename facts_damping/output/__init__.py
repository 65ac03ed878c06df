"""What users get to read: lines on the terminal, tables, files, pictures."""
