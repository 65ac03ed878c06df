"""Power system stabilisers."""
