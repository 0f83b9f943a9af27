"""Where the sonar was, from its own echoes: the track to a fraction of a wavelength, as images need it."""
