"""How the Numba engine is planned: few fixed, generous settings by their error bounds. No cost model, no search."""
