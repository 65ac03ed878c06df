"""What `analyze` adds to the figures of a run: details, and distributions over time and frequency."""
