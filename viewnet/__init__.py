"""ViewNet: unsupervised viewpoint estimation from conditional generation.

Where to begin:

- own images: `viewnet.estimator`, which returns `viewnet.estimator.viewpoints`
- a method of one's own in the tables: `viewnet.experiments.own_method`, or a file of its predictions,
  `viewnet.evaluation.submitted_predictions`
- tables and figures, as notebooks make them: `viewnet.experiments`, `viewnet.tables.table`, `viewnet.tables.plots`
- training: `viewnet.config` and `viewnet.recipes` configure a run, `viewnet.training.run_store` trains what is missing,
  `viewnet.evaluation.run` reads it
- from predictions to numbers: `viewnet.evaluation.predictions`, `viewnet.evaluation.alignment`,
  `viewnet.evaluation.metrics`, `viewnet.evaluation.evaluate`
- rendering volumes: `viewnet.model.volume`; images of a finished run: `viewnet.tables.run_renderer`
- conventions of angles and camera frames: `viewnet.geometry`
- real data: `viewnet.data.catalogue` lists what can be read, `viewnet.data` reads it

A user's mistake raises `viewnet.errors.ViewnetError`, one line that says what to do. Angles are in degrees.
"""
