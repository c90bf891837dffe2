"""ViewNet: unsupervised viewpoint estimation from conditional generation.

What a reader's own code calls, and where to begin:

- people's own images: `viewnet.estimator.viewpoint_estimator`, whose answers are `viewnet.estimator.viewpoints`
- a method of one's own in the tables: `viewnet.experiments.own_method`, or a file of what it said, `viewnet.evaluation.submitted_predictions`
- tables and figures, as notebooks make them: `viewnet.experiments`, `viewnet.tables.table`, `viewnet.tables.plots`
- training: `viewnet.config` says what a run is, `viewnet.training.run_store` trains what is missing, `viewnet.evaluation.predict` reads it
- from predictions to numbers: `viewnet.evaluation.predictions`, `viewnet.evaluation.alignment`, `viewnet.evaluation.metrics`, `viewnet.evaluation.evaluate`
- drawing volumes: `viewnet.model.volume`; what a finished run draws: `viewnet.tables.run_renderer`
- conventions of angles and frames: `viewnet.geometry`
- real data: `viewnet.data.catalogue` says what can be read, `viewnet.data` reads it

A mistake of the user's raises `viewnet.errors.ViewnetError`, one line that says what to do; angles are degrees.
"""
