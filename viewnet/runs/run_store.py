"""The run store: runs that are missing are trained, finished ones are reused.

    <paths.runs()>/<variant>/<key>/config.json            the configuration
                                   log.csv                a row for each validation (viewnet.training.train)
                                   checkpoint.safetensors the best weights
                                   predictions.parquet    for the validation and the test split; none where these
                                                          views cannot be scored (see run.can_be_scored)
                                   predictions-*.parquet  for photographs (see other_views.on_photographs)
                                   result.json            metrics (null where views cannot be scored) and their
                                                          origin; written last

The key is a hash of everything that decides a training: the configuration, the identity of the views, and the code of
`TRAINING`. Prediction and evaluation are cheap, so a change in their code repeats them and not the training.
"""

import contextlib
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import torch

from viewnet import paths
from viewnet.config import DataConfig, ModelConfig, RunConfig, TrainConfig, VideoConfig, known
from viewnet.data import augment
from viewnet.data.rendered_store import WORTH_PROCESSES
from viewnet.errors import ViewnetError
from viewnet.evaluation.baselines import UNTRAINED
from viewnet.evaluation.run import Run
from viewnet.model import checkpoint
from viewnet.model.viewnet import ViewNet
from viewnet.peers import registry
from viewnet.recipes import PEERS, make_config
from viewnet.runs import dask_cluster, make_run, worker_pool
from viewnet.runtime import distributed, provenance
from viewnet.runtime.parallel import MOST_THREADS, cores, pool

# fmt: off
TRAINING = (
    "geometry.py", "data/augment.py", "data/pairs.py", "evaluation/alignment.py", "evaluation/metrics.py",
    *(f"model/{name}.py" for name in (
        "checkpoint", "fast_layers", "losses", "networks", "precision", "reconstruction", "viewnet", "volume")),
    *(f"model/kernels/{name}.py" for name in (
        "bfloat16_numba", "norm_relu_cpu", "norm_relu_numba", "numba_call", "rotation_numba", "trilinear_llvm",
        "volume_cpu", "volume_gpu", "volume_numba", "volume_triton", "voxels_numba")),
    *(f"runtime/{name}.py" for name in ("distributed", "images", "memory", "random", "torchvision_weights")),
    *(f"training/{name}.py" for name in (
        "history", "matting", "optimisers", "paper", "step", "train", "validation")),
)
# fmt: on
"""The code that decides a training: its statements are part of every key (provenance.code_identity).

A module that training starts to use must be added here, or a change in it would go unnoticed; a test compares this list
with what viewnet.training.train imports.
"""
PEER_TRAINING = (
    *(name for name in TRAINING if not name.startswith("training/")),
    *(f"training/{name}.py" for name in ("history", "optimisers", "train_peer")),
    *("data/boxes.py", "peers/peer.py", "peers/splat_numba.py", "render/camera.py"),
)
"""The same of peers; to it come the files of the method itself (viewnet.peers.registry.code_of)."""
UNTRAINED_CODE = ("evaluation/baselines.py", "geometry.py")  # the same of predictors that need no training


def untrained(variant: str, config: RunConfig) -> RunConfig:
    """The configuration of a predictor of `UNTRAINED` on the views of `config`; unused settings are the defaults."""
    known(variant, UNTRAINED, "untrained variant")
    return replace(config, variant=variant, seed=0, model=ModelConfig(), train=TrainConfig())


def locate(config: RunConfig, identity: str, backgrounds: str = "") -> Path:
    """The folder of a run on views, and before backgrounds, of these identities, wherever their files lie."""
    code = TRAINING if config.variant not in UNTRAINED else UNTRAINED_CODE
    if config.variant in PEERS:
        code = (*PEER_TRAINING, *registry.code_of(config.variant))
    data = replace(config.data, root=None, splits=None, extra=None, backgrounds=None)
    if data.video is not None:
        video = replace(data.video, root=None, mask_folder=VideoConfig.mask_folder)
        data = DataConfig(data.category, video=video)  # of videos only their own settings count, not those of rendering
    # Where files lie decides nothing: copies of the data give the same run, and their content is in the identities.
    without_places = replace(config, data=data, train=replace(config.train, start=None))
    identities = [identity, backgrounds] if backgrounds else [identity]
    identities += [checkpoint.identity(config.train.start)] if config.train.start else []
    return paths.runs() / config.variant / without_places.key(*identities, provenance.code_identity(code))


def weights(config: RunConfig) -> int:
    """How many weights the network of a run has. ViewnetError for settings of which none can be built."""
    with torch.device("meta"):  # no room is made for them
        network = registry.make(config.variant, config.model) if config.variant in PEERS else ViewNet(config.model)
    return sum(map(torch.Tensor.numel, network.state_dict().values()))


def check(configs: Sequence[RunConfig], train: bool = True) -> None:
    """Raise ViewnetError for settings of which no network can be built and, to `train`, for what would end a training.

    So that it is said before anything is rendered.
    """
    for config in dict.fromkeys(configs):
        if config.variant in UNTRAINED:
            continue
        # A profile's own network can be built; building one, if only for its size, takes a second.
        if config.model != make_config(config.variant, profile=config.profile, recipe=config.recipe).model:
            weights(config)
        if not train:
            continue
        if config.data.video is None and config.data.views < 2:
            raise ViewnetError(f"views {config.data.views}: training needs two or more of every model")
        if config.train.start:
            checkpoint.locate(config.train.start)


def ensure(
    configs: Sequence[RunConfig],
    workers: int | None = None,
    progress: bool = True,
    steps: make_run.Steps | None = None,
    executor: Executor | None = None,
    finished: Callable[[Run], None] | None = None,
) -> list[Run]:
    """The runs of `configs`, in their order; missing ones are trained first, the longest before the others.

    With `finished` they are trained in the order of `configs` instead, and it is called for each run that is there or
    ends, so that what is done can be kept while others go on.

    Up to `workers` are trained side by side in processes of their own, each with OMP_NUM_THREADS threads, or else its
    share of the cores (default: as many as there are GPUs, or without any as there are cores for). Runs that another
    process is training are waited for. A failed run leaves the others to end; then ViewnetError names each and why.

    With an `executor`, or a cluster in VIEWNET_CLUSTER, views are rendered and runs trained there; its workers must see
    the same files. Under torchrun every process calls this and trains each run with the others; a failure ends all.
    """
    if workers is not None and not 1 <= workers <= MOST_THREADS:
        raise ViewnetError(f"workers {workers}: expected 1 to {MOST_THREADS}")
    steps = steps or make_run.default_steps()
    distributed.start()
    with contextlib.nullcontext(executor) if executor else dask_cluster.executor() as executor:
        if (executor is not None or finished) and distributed.size() > 1:
            other = "--cluster" if executor is not None else "a queue"
            raise ViewnetError(f"torchrun and {other} cannot be combined: torchrun is for one run")
        in_order = finished is not None
        folders, jobs = distributed.first(lambda: _plan(configs, workers, progress, steps, executor, in_order))
        if finished:
            unfinished = {job.folder for job in jobs}
            for config, folder in folders.items():
                if folder.absolute() not in unfinished:
                    finished(Run(config, folder))
        # A torchrun is for one run at a time; its processes end together, so that the first failure ends all.
        if distributed.size() > 1:
            worker_pool.make_together(jobs, steps, progress)
        elif failures := worker_pool.run_all(jobs, steps, workers, progress, executor, finished):
            raise ViewnetError(f"{len(failures)} of {len(folders)} runs failed: {'; '.join(failures)}")
    return [Run(config, folders[config]) for config in configs]


def _plan(
    configs: Sequence[RunConfig],
    workers: int | None,
    progress: bool,
    steps: make_run.Steps,
    executor: Executor | None,
    in_order: bool,
) -> tuple[dict[RunConfig, Path], list[make_run.Job]]:
    """Each configuration's folder, and the runs that are not finished. Makes the views of all."""
    unique = list(dict.fromkeys(configs))
    check(unique)
    data = dict.fromkeys(config.data for config in unique)
    views = sum(each.models * each.views for each in data if each.video is None)
    shared = executor is None and workers != 1 and views >= WORTH_PROCESSES
    with pool(workers or cores()) if shared else contextlib.nullcontext(executor) as crew:  # started once for all
        stores = {each: steps.views(each, workers=workers, progress=progress, executor=crew) for each in data}
    folders = {c: locate(c, stores[c.data].identity, _backgrounds_identity(c, progress)) for c in unique}
    missing = [config for config in unique if not make_run.is_complete(folders[config])]
    if missing:
        provenance.commit()  # says here where it is unknown: the processes that train do not
    if not in_order:  # the longest first and the shortest last, so that no core waits long at the end
        missing.sort(key=lambda c: (c.model.decoder != "hologan", not c.train.cycle.on, c.model.heads == 1))
    jobs = []
    for config in missing:  # with absolute paths, since another machine's process has another working directory
        start = config.train.start and str(checkpoint.locate(config.train.start))
        same = replace(config, train=replace(config.train, start=start))
        jobs.append(make_run.Job(same, folders[config].absolute(), Path(stores[config.data].folder).absolute()))
    return folders, jobs


def _backgrounds_identity(config: RunConfig, progress: bool) -> str:
    """The identity of the backgrounds that a run is trained with, "" for none. Makes them where they are missing."""
    backgrounds = augment.made(config.data, config.model.input_size, progress)
    return "" if backgrounds is None else backgrounds.identity
