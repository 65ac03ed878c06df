"""Laws that run as users' classes: an observer that predicts by the measured age of the frames."""
