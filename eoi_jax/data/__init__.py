"""Records of measured signals: reading, resampling, excitation."""
