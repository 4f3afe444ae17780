"""Problems as nonlinear programs: one module a transcription."""
