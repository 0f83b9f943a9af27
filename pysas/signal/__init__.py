"""Signal processing of pings: matched filters, phase history to samples, what recordings look like."""
