"""Records on a uniform clock, campaigns of tests, units, kinds of test, segmentation of mixed logs."""
