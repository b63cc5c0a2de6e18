"""What the command line runs: record a dataset, report and evaluate a calibration."""
