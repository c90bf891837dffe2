"""ViewNet: unsupervised viewpoint estimation from conditional generation.

What a reader's own code calls, and where to begin:

- people's own pictures: `viewnet.estimator`, whose answers are `viewnet.estimates`
- a method of one's own in the tables: `viewnet.method`, or a file of what it said, `viewnet.prediction_file`
- tables and figures, as notebooks make them: `viewnet.experiment`, `viewnet.tables`, `viewnet.figures`
- training: `viewnet.config` says what a run is, `viewnet.runs` trains what is missing, `viewnet.predict` reads it
- from predictions to numbers: `viewnet.predictions`, `viewnet.alignment`, `viewnet.metrics`, `viewnet.evaluate`
- drawing volumes: `viewnet.volume`; what a finished run draws: `viewnet.drawing`
- conventions of angles and frames: `viewnet.geometry`
- real data: `viewnet.data_sets` says what can be read, `viewnet.data` reads it

A mistake of the user's raises `viewnet.errors.ViewnetError`, one line that says what to do; angles are degrees.
"""
