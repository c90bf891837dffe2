"""ViewNet: unsupervised viewpoint estimation from conditional generation.

`config`, `recipes`, `geometry`, `errors` and `paths` are settings, conventions, the one exception that users see
(`viewnet.errors.ViewnetError`) and folders. The rooms import each other in one direction, from below to above:

    runtime      files, processes, random numbers, provenance
    cad          built-in CAD models            render    images of meshes
    model        networks, losses, the volume renderer, checkpoints
    data         view stores, pairs, augmentation, readers of data sets
    evaluation   predictions, alignment, metrics, finished runs
    training     the training step, the loop, the store of runs
    tables       tables, figures and images of finished runs
    estimator    viewpoints of people's own images (`from viewnet.estimator import ViewpointEstimator`)
    bench        speed and memory beside a textbook version
    experiments  what each notebook asks for, own methods, the page of all tables
    commands     the commands of `viewnet`, which `cli` lists

Angles are in degrees.
"""
