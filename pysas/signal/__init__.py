"""Signal processing of pings: demodulation, matched filters, phase history to samples, what recordings look like."""
