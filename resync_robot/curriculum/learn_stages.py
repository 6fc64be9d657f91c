"""The walk of a training run: stage after stage, each on top of what the ones before it left."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from resync_robot.core.embodiment import Stage
from resync_robot.core.errors import ConfigError, TrainingError, UnknownNameError
from resync_robot.core.library import LearnedStage, Library, Record, load_library, save_library
from resync_robot.core.rig import Rig
from resync_robot.core.symbols import Object, Type
from resync_robot.core.task import Domain
from resync_robot.core.trajectory import Trajectory
from resync_robot.curriculum.context import Known
from resync_robot.curriculum.dream import dream, earlier_dreams
from resync_robot.curriculum.mine import Mined, mine
from resync_robot.curriculum.model_card import with_card
from resync_robot.curriculum.plots import draw_learning_curve, draw_model
from resync_robot.curriculum.presets import ARM_PRESETS, STAGE_PRESETS, TRAINING_SEEDS, StagePreset
from resync_robot.curriculum.recover import check, recover
from resync_robot.curriculum.run_folder import RunFolder
from resync_robot.curriculum.stage_folder import StageFolder, Tell
from resync_robot.curriculum.taken_over import TAKE_OVER, take_over
from resync_robot.learning.concepts import learn_concepts
from resync_robot.learning.dataset import StageData
from resync_robot.learning.failures import FailureModel, PairGaussian
from resync_robot.learning.model import Concepts
from resync_robot.library_models import known_concepts, learned_names, make_library
from resync_robot.planning.model_graph import graph_of

STEPS = ("mine", "recover", "check", "dream", "discover", "save")
DISTIL = "distil"
"""The step before the last one, where the recovery is to see by camera."""
STAGE_SEEDS, STEP_SEEDS = 100_000, 15_000
"""Of these each stage, and each of its steps, owns so many."""
Watch = Callable[[str], Any]
"""A step's name -> a context that yields its `Tell`, for the progress bars."""


@dataclass(frozen=True, kw_only=True)
class Curriculum:
    """What is to be learned, and how.

    Attributes:
        stages: in the order of learning.
        rig: of an arm.
        known: the library to build on, and where it lies; None to begin with the given model.
        elsewhere: a library of another domain. A recovery that it holds under the name that a stage gives to its own
            is taken over, with the camera policy; what it means here is learned.
        provenance: what every library says of how it came about.
        by_camera: teach an arm's recovery to see by camera, too.
        device: where that is learned, and an arm's recovery.
    """

    domain: Domain
    stages: tuple[Stage, ...]
    preset: str
    seed: int
    workers: int
    concepts: str
    provenance: Mapping[str, Any]
    rig: Rig | None = None
    known: Library | None = None
    known_at: Path | None = None
    elsewhere: Library | None = None
    by_camera: bool = False
    device: str = "cpu"

    def takes_over(self, stage: Stage) -> bool:
        """Does another domain's library hold the recovery of this stage?"""
        return self.elsewhere is not None and stage.recovery in self.elsewhere.skills

    def steps(self, stage: Stage) -> tuple[str, ...]:
        """Of a stage."""
        if self.takes_over(stage):
            return tuple(TAKE_OVER if step == "recover" else step for step in STEPS)
        return (*STEPS[:-1], DISTIL, STEPS[-1]) if self.by_camera else STEPS

    @property
    def budgets(self) -> StagePreset:
        """Those of the preset."""
        return (STAGE_PRESETS if self.rig is None else ARM_PRESETS)[self.preset]

    def seeds(self, number: int, step: str) -> range:
        """The world seeds of one step of the stage of that number, from 1."""
        first = self.seed * TRAINING_SEEDS + number * STAGE_SEEDS + STEPS.index(step) * STEP_SEEDS
        return range(first, first + STEP_SEEDS)


def chosen_stages(domain: Domain, words: str, known: Library | None) -> tuple[Stage, ...]:
    """The stages that `--stages` names, in its order; where it names none, all that are not known yet.

    Raises:
        UnknownNameError: the domain has no such stage.
        ConfigError: one is known already, or named twice, or none is left.
    """
    done = [s.recovery for s in known.stages] if known is not None else []
    if not words:
        found = [s for s in domain.stages if s.recovery not in done]
    else:
        by_name = {s.recovery: s for s in domain.stages} | {str(i): s for i, s in enumerate(domain.stages, 1)}
        found = []
        for word in (w.strip() for w in words.split(",") if w.strip()):
            if word not in by_name:
                raise UnknownNameError(f"stage of {domain.name}", word, list(by_name))
            if by_name[word] in found or by_name[word].recovery in done:
                where = "is named twice" if by_name[word] in found else "is in the library of --from already"
                raise ConfigError(f"stage {word} {where}", "leave it out of --stages")
            found.append(by_name[word])
    if not found:
        raise ConfigError("there is no stage left to learn", "leave --from out to begin anew")
    return tuple(found)


def learn_stages(curriculum: Curriculum, run: RunFolder, watch: Watch) -> Library:
    """Learn every stage that the run folder does not hold yet; the last library is also the run's own.

    Raises:
        ResyncError: a stage cannot produce what the next one needs, or a file of the run is damaged.
    """
    library, data = curriculum.known, _earlier(curriculum, run, watch)
    for number, stage in enumerate(curriculum.stages, start=len(data) + 1):
        library, learned = _Stage(curriculum, StageFolder(run, number, stage.recovery), stage, library, watch).learn(
            data
        )
        data = [*data, learned]
    if library is None:
        raise TrainingError("there is no stage to learn", "name one with --stages")
    save_library(library, run.library)
    return library


def _earlier(c: Curriculum, run: RunFolder, watch: Watch) -> list[StageData]:
    """What the stages of the library that the run builds on were fed: a stage on its own forgets them.

    Their dreams are dreamed anew, with the given model, where their files are gone.
    """
    if c.known is None:
        return []
    found: list[StageData] = []
    for number, learned in enumerate(c.known.stages, start=1):
        place = _place_of(c.known_at, number, learned)
        if place is not None:
            trajectories = earlier_dreams(c.domain, place)
        else:
            trajectories = _dreamt_again(c, c.known, run, number, watch)
        found.append(_data(c.domain, learned, c.known.skills[learned.recovery], trajectories))
    return found


def _place_of(library: Path | None, number: int, learned: LearnedStage) -> Path | None:
    """The library in a run folder that ends with this stage, with its dreams beside it."""
    if library is None:
        return None
    name = f"{number}-{learned.recovery}"
    for folder in (library.resolve().parent.parent, library.resolve().parent / "stages"):
        place = folder / name / "library"
        if place.is_dir() and load_library(place).stages[-1:] == (learned,) and any((folder / name).glob("dreams-*")):
            return place
    return None


def _dreamt_again(c: Curriculum, known: Library, run: RunFolder, number: int, watch: Watch) -> list[Trajectory]:
    stages = known.stages[:number]
    failures = tuple(FailureModel.from_learned(s.recovery, s.failure, c.domain) for s in stages)
    plain = Known(domain=c.domain.spec, rig=c.rig)
    for s in stages:
        plain = plain.with_recovery(s.recovery, known.skills[s.recovery])
    folder, scenarios = StageFolder(run, number, stages[-1].recovery), tuple(s.scenario for s in stages)
    with folder.timed("dream"), watch(f"{folder.name}/dream") as tell:
        b, seeds, count = c.budgets, c.seeds(number, "dream"), c.budgets.dreams_of(number)
        return dream(plain, c.domain, failures, scenarios, folder, seeds, count, b.attempts, c.workers, tell)


def _data(domain: Domain, learned: LearnedStage, record: Record, trajectories: Sequence[Trajectory]) -> StageData:
    types = {t.name: t for t in domain.types}
    signature: tuple[Type, ...] = tuple(types[name] for name in record.meta["signature"])
    return StageData(learned.recovery, signature, learned.failure.skill, trajectories)


class _Stage:
    """One stage of a run: its steps in order."""

    def __init__(
        self, curriculum: Curriculum, folder: StageFolder, stage: Stage, library: Library | None, watch: Watch
    ) -> None:
        self._c, self._folder, self._stage, self._library, self._watch = curriculum, folder, stage, library, watch
        self._known = Known(domain=curriculum.domain.spec, rig=curriculum.rig, library=library)

    def learn(self, data: Sequence[StageData]) -> tuple[Library, StageData]:
        """What is known after it, and what it was fed.

        Args:
            data: of the stages before.
        """
        c, stage, folder, number = self._c, self._stage, self._folder, self._folder.number
        domain, budgets, workers = c.domain, c.budgets, c.workers
        with self._step("mine") as tell:
            seeds, count = c.seeds(number, "mine"), budgets.explained if c.takes_over(stage) else budgets.failures
            mined = mine(domain, stage, folder, self._known, seeds, count, workers, tell)
        record = self._recovery(mined)
        able = self._known.with_recovery(stage.recovery, record)
        with self._step("check") as tell:
            seeds = c.seeds(number, "check")[: budgets.checks]
            after, changed = check(able, able.open(), stage, folder, mined, seeds, workers, tell)
        newest = _failure(stage, mined, after, changed)
        before = self._library.stages if self._library is not None else ()
        failures = (*(FailureModel.from_learned(s.recovery, s.failure, domain) for s in before), newest)
        scenarios = (*(s.scenario for s in before), stage.scenario)
        with self._step("dream") as tell:
            seeds, count = c.seeds(number, "dream"), budgets.dreams_of(number)
            dreams = dream(able, domain, failures, scenarios, folder, seeds, count, budgets.attempts, workers, tell)
        types = tuple(o.type for o in mined.explanation.parameters)
        own = StageData(stage.recovery, types, newest.skill, dreams)
        if folder.figures("save") and (folder.library / "library.json").exists():
            return load_library(folder.library), own
        with self._step("discover") as tell:
            concepts = self._discover([*data, own], tell)
            folder.record("discover", {"report": concepts.report})
        policy = self._policy(record, newest) if c.by_camera else None
        with self._step("save"):
            return self._save(record, newest, concepts, policy), own

    def _recovery(self, mined: Mined) -> Record:
        """What mends the failure: learned, or taken over."""
        c, stage = self._c, self._stage
        if c.elsewhere is not None and c.takes_over(stage):
            with self._step(TAKE_OVER):
                return take_over(stage, self._folder, c.elsewhere)
        with self._step("recover") as tell:
            trials = c.seeds(self._folder.number, "recover")[: c.budgets.checks]
            return recover(
                self._known, stage, self._folder, c.budgets, mined, c.seed, trials, c.workers, tell, c.device
            )

    @contextmanager
    def _step(self, name: str) -> Iterator[Tell]:
        with self._folder.timed(name), self._watch(f"{self._folder.name}/{name}") as tell:
            yield tell

    def _discover(self, data: Sequence[StageData], tell: Tell) -> Concepts:
        c, name = self._c, self._stage.recovery
        known = known_concepts(c.domain, self._library) if self._library is not None else None
        concepts = learn_concepts(
            data,
            c.domain,
            known,
            mode=c.concepts,
            seed=c.seed,
            progress=lambda what, share: tell(share, what),
        )
        # A recovery that achieves nothing is never planned for, and what later stages practise would rely on it.
        achieved = {a.predicate.name for o in concepts.operators if o.name == name for a in o.add}
        if not achieved & concepts.records.keys():
            self._folder.record("discover", {"report": concepts.report})
            raise TrainingError(
                f"no predicate was found that {name} brings about; what was tried is in {self._folder.run.path}"
                f"/metrics.json, {self._folder.name}/discover",
                "train with more dreams: --preset full, or with another --seed",
            )
        return concepts

    def _policy(self, record: Record, failure: FailureModel) -> Mapping[str, bytes]:
        """The files of the recovery's camera policy."""
        if self._c.elsewhere is not None and self._c.takes_over(self._stage):
            return self._c.elsewhere.policies[self._stage.recovery]
        from resync_robot.curriculum.distil import PLANS, distil  # LeRobot and a renderer, which few runs need

        c = self._c
        if c.rig is None:
            raise ConfigError("only an arm sees by camera", "leave --skills out")
        cause = failure.causes[0]
        lies = {"before": failure.before[cause], "after": failure.after[cause]}
        with self._step(DISTIL) as tell:
            return distil(c.domain, self._folder, PLANS[c.preset], record, lies, c.seed, c.workers, c.device, tell)

    def _save(
        self, record: Record, failure: FailureModel, concepts: Concepts, policy: Mapping[str, bytes] | None
    ) -> Library:
        c, folder, stage = self._c, self._folder, self._stage
        learned = LearnedStage(
            recovery=stage.recovery,
            scenario=stage.scenario,
            failure=failure.to_learned(),
            figures=folder.all_figures,
        )
        library = make_library(c.domain, c.rig, learned, record, concepts, c.provenance, policy, self._library)
        draw_model(graph_of(concepts.operators, learned_names(c.domain, library)), folder.path / "model.png")
        if c.takes_over(stage):
            save_library(library, folder.library)
            folder.record("save", {"content_hash": library.content_hash})
            return library
        library = with_card(library, c.domain)
        save_library(library, folder.library)
        folder.record("save", {"content_hash": library.content_hash})
        curve, stop_at = folder.figures("recover")["curve"], c.budgets.recovery.ppo.stop_at
        # Only once the first episodes can have run out of time all count, and not just those that end early.
        begins = folder.figures("recover").get("scenes", c.budgets.recovery.ppo.scenes) * stage.horizon
        draw_learning_curve(curve, folder.path / "recovery.png", begins, stop_at)
        return library


def _failure(
    stage: Stage,
    mined: Mined,
    after: Mapping[Object, PairGaussian],
    changed: Mapping[Object, Mapping[str, tuple[float, float]]],
) -> FailureModel:
    """What the stage knows about its failure."""
    about = mined.explanation
    return FailureModel(
        recovery=stage.recovery,
        skill=about.skill,
        argument=about.objects.index(about.relevant) if about.relevant in about.objects else None,
        relevant=about.relevant.type,
        causes=about.culprits,
        before=mined.before,
        after=after,
        changed=changed,
    )
