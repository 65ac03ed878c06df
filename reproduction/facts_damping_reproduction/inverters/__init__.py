"""What inverters do to wide-area damping: the study behind docs/inverters_results.md."""
