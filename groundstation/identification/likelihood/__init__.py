"""One likelihood for the fits and the search: residuals, noise spectra, joint fits. Pure."""
