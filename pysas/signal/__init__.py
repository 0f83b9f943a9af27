"""Signal processing of pings: simulated echoes, matched filters, phase history to samples."""
