"""Objects followed through sequences of frames: ``omad.Tracker``."""
