"""What data that nothing was fitted to say of the causes found: their gain, and what contradicts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from engine.data.joined import apart, joined, past_of
from engine.data.series import Series
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Course
from engine.diagnose.first_states import anywhere, starts_there
from engine.diagnose.free_run.answer import FreeRunSearch, causes_of
from engine.diagnose.free_run.oversampled import thinned_by
from engine.diagnose.free_run.search import Candidate
from engine.diagnose.free_run.second_opinion import SecondOpinion, heeding
from engine.diagnose.free_run_fits.candidates import FAMILIES
from engine.diagnose.gain.adoption import (
    NOT_MEASURED,
    Decision,
    falls_short,
    in_its_place,
    not_beside,
    nothing_better,
    runs_worse,
)
from engine.diagnose.gain.chance import is_faint, taken_for_chance
from engine.diagnose.gain.gain import Gain, measure_gain, measure_gain_interleaved, without
from engine.diagnose.gain.narrowing import (
    last_alone,
    narrowed,
    with_fair_noise,
    with_noise_of,
)
from engine.diagnose.judging.by_record import word_of_records
from engine.diagnose.judging.contradictions import particle_word
from engine.diagnose.judging.findings import Cause, Verdict
from engine.diagnose.judging.in_gaps import in_gaps
from engine.diagnose.judging.judgement import NAMES, has_tails
from engine.diagnose.judging.moments_missed import (
    log_likelihood_of,
    missed_in_words,
    nats_missed,
)
from engine.diagnose.judging.verdict import named_by, names_of
from engine.diagnose.records import Records
from engine.diagnose.refits.found import Search, without_names
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.refits.rounds import Round, settle
from engine.diagnose.screening.screening import Progress
from engine.diagnose.search.pipeline import Causes
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.words import enumerated, number

TESTS_NOT_USED = (
    "The test data were not used: what was found comes with time, and they do not follow the record. Its gain "
    "is of blocks of what was searched, left out in turn."
)
FAIR_NOISE = " (the noise of both fitted beside their other parameters)"
NOISE_OF_ALL = ", with the noise of both fitted to them, too"


@dataclass(frozen=True, eq=False)
class Judged:
    """The answer after held-out data were asked: verdict, causes, fits ``before`` and ``after`` extending.

    Their noise is that of all records where the ``gain`` says so. ``search`` is the likelihood's, without
    members of a set that were contradicted; ``notes`` say what was, and ``why`` no name is trusted.
    """

    verdict: Verdict
    causes: tuple[Cause, ...]
    before: QuasiFit
    after: QuasiFit
    gain: Gain | None
    search: Search
    free_run: SecondOpinion
    notes: tuple[str, ...] = ()
    by_record: str = ""
    why: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The ``records``, with their tests, whole ones or their last part held out, if any.

    ``searched`` are the rows that the likelihood has searched, with a share ``alpha`` of false alarms.
    """

    records: Records
    searched: Series
    seed: int
    alpha: float

    def judge(
        self,
        found: Causes,
        asked: SecondOpinion,
        progress: Progress = lambda stage, share: None,
    ) -> Judged:
        """The causes of the criterion that decides, with what they gain where nothing was fitted."""
        judged = self._heeding_particles(self._judged(found, asked, progress))
        judged = self._heeding_gaps(self._heeding_records(judged))
        extended = judged.causes and judged.after is not judged.before
        if extended and judged.gain is None and not self.records.held_out:
            return replace(judged, notes=(*judged.notes, NOT_MEASURED))
        if (
            judged.gain is not None
            and judged.gain.among
            and self.records.tests
            and not self.records.kept_back
        ):
            return replace(judged, notes=(*judged.notes, TESTS_NOT_USED))
        return judged

    def _heeding_particles(self, judged: Judged) -> Judged:
        """The same, with a note and maybe no names where the moment filter is far from the likelihood.

        Of the answer of the free run, too: what noise explains of it is drawn with parameters by that filter.
        """
        both = (judged.before, judged.after)
        missed = nats_missed(*both, self.searched, self.seed)
        if not missed:
            return judged
        before, after = (log_likelihood_of(one, self.searched) for one in both)
        extended = bool(judged.causes) and judged.after is not judged.before
        notes = (missed_in_words(missed, after - before, extended), *judged.notes)
        if judged.verdict not in NAMES or not missed > after - before:
            return replace(judged, notes=notes)
        return replace(judged, verdict=Verdict.UNKNOWN, notes=notes, why=notes[:1])

    def _heeding_records(self, judged: Judged) -> Judged:
        """The same where the records have one set of parameters; else with a note, and maybe no names."""
        if not self.searched.begins:
            return judged
        named = judged.causes if judged.verdict in NAMES else ()
        word = word_of_records(
            judged.before,
            judged.after,
            self.searched,
            self.records.numbers_of(apart(self.searched)),
            [cause.effect for cause in named],
            [cause.effect for cause in named if cause.where == "noise"],
            [next(iter(cause.parameters)) for cause in named if cause.where != "parameter"],
            [name for cause in named for name in cause.parameters if name.endswith("_frequency")],
        )
        if word is None:
            return judged
        verdict = Verdict.UNKNOWN if word.refutes else judged.verdict
        notes = *judged.notes, word.sentence
        return replace(judged, verdict=verdict, notes=notes, by_record=word.short)

    def _heeding_gaps(self, judged: Judged) -> Judged:
        """The same without names that act only where the record has no rows."""
        against = (*in_gaps(judged.causes, self.searched),)
        if not against:
            return judged
        notes, why = (*against, *judged.notes), (*against, *judged.why)
        return replace(judged, verdict=Verdict.UNKNOWN, notes=notes, why=why)

    def _judged(self, found: Causes, asked: SecondOpinion, progress: Progress) -> Judged:
        search, free_run = found.search, asked.search
        if asked.decides and free_run is not None:
            notes: tuple[str, ...] = ()
            if free_run.found:
                free_run, notes = self._borne_out(free_run)
                asked = replace(asked, search=free_run, missing=free_run.missing)
                causes, before, after = causes_of(free_run), free_run.before, free_run.after
                gain = self._gain_of(before, after)
            else:  # what is shown, and judged, is what the likelihood has named
                causes, before, after = named_by(search), search.base, search.final
                gain = self._gain(search)
            decision = gain.decision if gain is not None and free_run.found else None
            none_better = decision is not None and gain is not None and nothing_better(gain)
            heeded, verdict = heeding(asked, free_run.verdict, decision, none_better)
            if heeded.decides:
                return Judged(verdict, causes, before, after, gain, search, heeded, notes)
            return self._by_likelihood(found, verdict, heeded, progress)
        verdict = Verdict.UNKNOWN if asked.refutes else found.verdict
        return self._by_likelihood(found, verdict, asked, progress)

    def _by_likelihood(
        self, found: Causes, verdict: Verdict, asked: SecondOpinion, progress: Progress
    ) -> Judged:
        search, notes = found.search, list[str]()
        why = [asked.reason] if asked.refutes else []
        why += found.why if verdict is Verdict.UNKNOWN else ()
        if verdict in NAMES:
            left = narrowed(search, self._asked, partial(self._settled, found.setting), progress)
            search, gain = left.search, left.gain
            notes.extend(filter(None, (left.note, left.objection)))
            if left.objection or left.note:
                verdict = Verdict.UNKNOWN if left.objection else names_of(search)
            why += filter(None, [left.objection])
        else:
            gain = self._gain(search)
        chance = "" if asked.sees(self.alpha) else taken_for_chance(search, gain, self.alpha)
        if chance:
            base, none = search.base, without_names(search)
            said = chance, *notes
            return Judged(Verdict.NOTHING, (), base, base, None, none, asked, said, why=(chance,))
        extended = bool(named_by(search)) and search.final is not search.base
        if extended and found.base.model.na:
            text, contradicts = self._particle_word(found.base, search)
            notes.append(text)
            why += [text] if contradicts else []
            verdict = Verdict.UNKNOWN if contradicts else verdict
        own = (search.base, search.final)
        before, after = own if gain is None or gain.fits is None else gain.fits
        causes, said = named_by(search), tuple(notes)
        return Judged(verdict, causes, before, after, gain, search, asked, said, why=tuple(why))

    def _settled(self, setting: Setting, found: Round, refits: Sequence[Refit]) -> Round:
        """A round of these refits alone."""
        unnamed = [found.generic] if found.generic else []
        return settle(found.screen, [*refits, *unnamed], self.searched, setting)

    def _borne_out(self, found: FreeRunSearch) -> tuple[FreeRunSearch, tuple[str, ...]]:
        """What the free run found, as far as it does no worse where nothing was fitted; a note on each change.

        The rows left out that it chose by are of the record searched, and each addition bends to its errors
        further. Where the last one loses, another of its set that does not stands for it; without one, it is
        left out beside others. Where it takes too many no name is trusted, be there fewer or not.
        """
        notes: tuple[str, ...] = ()
        while not found.is_patchwork and (lost := self._lost(found)) is not None:
            chosen, *others = found.rounds[len(found.found) - 1].survivors
            left = [group for group in others if self._stands(found, group)]
            if left:
                found = found.left_with(left)
                notes = (*notes, in_its_place(chosen[0].names, found.found[-1].names, lost))
                break
            if len(found.found) == 1:
                break
            last, found = found.found[-1], found.without_last()
            named = [name for one in found.found for name in one.names]
            notes = (*notes, not_beside(last.names, named, lost))
        return found, notes

    def _stands(self, found: FreeRunSearch, group: tuple[Candidate, ...]) -> bool:
        """Whether another survivor of the last round can be had, and does not lose on held-out data."""
        try:
            return self._lost(found.left_with([group])) is None
        except (EngineError, np.linalg.LinAlgError):
            return False

    def _lost(self, found: FreeRunSearch) -> Gain | None:
        """What the last addition of a free run's search loses on held-out data, None where it does not."""
        gain = self._gain_of(found.fits[-2], found.fits[-1])
        lost = gain is not None and (gain.decision is Decision.LOSES or nothing_better(gain))
        return gain if lost else None

    def _gain(self, search: Search) -> Gain | None:
        """What the likelihood's extension gains.

        None without one, and where no rows are held out and it is not of time alone. What comes with time may
        be gone in the record's last rows, so it is judged among those that chose it. A faint wave is not: there
        any frequency gains that was chosen by them, and a wave goes on.
        """
        causes, before, after = named_by(search), search.base, search.final
        chosen = [r.refits[0].effect for r in search.rounds if r.equivalent]
        if not causes or after is before:
            return None
        begins = [e for e in chosen if e.traits.of_record]
        waves = self.records.keeps_back and is_faint(search, self.alpha)
        waves = waves and all(e.traits.course is Course.HARMONIC for e in chosen)
        goes_on = waves or (self._later and (not begins or len(begins) < len(chosen)))
        if not goes_on and all(cause.where == "time" for cause in causes):
            times = [name for e in chosen for name in e.sought]
            return measure_gain_interleaved(before, after, self._searched, times, self.seed)
        return self._gain_of(before, after, begins)

    def _gain_of(
        self, before: QuasiFit, after: QuasiFit, begins: Sequence[Effect] = ()
    ) -> Gain | None:
        """What a fit gains over another on the rows held out, if any are; ``begins`` are of one record."""
        tests, train, held_out = self.records.tests, self.records.train, self.records.held_out
        if not held_out:
            return None
        return measure_gain(
            before,
            after,
            held_out,
            None if tests else train,
            self.seed,
            (train, *self.records.others) if tests else (),
            without(after, begins),
        )

    @property
    def _later(self) -> bool:
        """Whether all tests follow the main record, so that what came with time there may still be there.

        Else their clock is their own, or a drift would have gone on for longer than it was seen.
        """
        main, tests = self.records.main, self.records.tests
        span = main.t[-1] - main.t[0]
        return bool(tests) and all(0.0 < one.t[0] - main.t[-1] <= span for one in tests)

    @property
    def _searched(self) -> list[Series]:
        """All records in which the likelihood has looked for effects of time, the main one to its end."""
        return [self.records.main, *apart(self.searched)[1:]]

    def _asked(self, search: Search) -> tuple[Gain | None, str]:
        """The gain of the likelihood's answer, and what contradicts it."""
        gain = self._gain(search)
        objection = "" if gain is None else falls_short(gain, self._promised(search, gain))
        if objection:  # noise that was fitted too small loses much elsewhere, and is no other cause
            try:
                fair = self._gain(with_fair_noise(search, self.searched))
            except (EngineError, np.linalg.LinAlgError):
                fair = None
            if fair is not None:
                objection = falls_short(fair, self._promised(search, fair), FAIR_NOISE)
        noises = [one.effect.name for one in search.named if one.effect.family == "noise"]
        if gain is not None and not objection:
            others = [one.effect.name for one in search.named if one.effect.name not in noises]
            objection = runs_worse(gain, others, noises)
        if objection and gain is not None and not (gain.among or noises):
            gain, objection = self._asked_with_noise_of_all(search, gain, objection)
        return gain, objection or self._objection_to_last(search)

    def _objection_to_last(self, search: Search) -> str:
        """What contradicts the last of several names, beside the others; their sum may hide what it loses.

        Not beside outliers, which are left out of what is searched after them.
        """
        if len(search.named) < 2 or has_tails(search):
            return ""
        try:
            objection = self._asked(last_alone(search, self.searched))[1]
        except (EngineError, np.linalg.LinAlgError):
            return ""
        *others, last = (one.effect.name for one in search.named)
        return objection and f"Of {last} beside {enumerated(others)}: {objection}"

    def _asked_with_noise_of_all(
        self, search: Search, gain: Gain, objection: str
    ) -> tuple[Gain | None, str]:
        """The same with noise that is known from the held-out rows, too, where that leaves no objection.

        A model that leaves nothing to noise predicts worse for as long as anything else moves it, be its cause
        right or not. One that is wrong predicts worse with any noise. Not for a cause that is noise itself.
        """
        try:
            known = self._with_noise_of_all(search)
            again = self._gain(known)
        except (EngineError, np.linalg.LinAlgError):
            return gain, objection
        if again is None or not again.adopt:
            return gain, objection
        note = (
            f"With the noise of the record searched the extension loses {number(-gain.log_density)} in "
            "log-density there, as that leaves too little to it. So the noise of both models was fitted to the "
            "held-out rows as well, and all else was not."
        )
        how, notes = again.how + NOISE_OF_ALL, (*again.notes, note)
        return replace(again, how=how, notes=notes, fits=(known.base, known.final)), ""

    def _with_noise_of_all(self, search: Search) -> Search:
        """The search with the noise of its models fitted to what it has searched and the held-out rows."""
        records, pair = self.records, (search.base, search.final)
        every, anew = [records.main if records.keeps_back else self.searched], list[Series]()
        for test in records.tests:
            past = past_of(test, (records.train, *records.others))
            every.append(test if past is None else joined(past, test))
            anew += [test] if past is None else []
        if any(not any(starts_there(fit, test) for fit in pair) for test in anew):
            pair = anywhere(*pair, records.train)
        wide = replace(search, base=pair[0], final=pair[1])
        found = with_noise_of(every, wide, self.searched)
        return replace(
            found,
            base=replace(found.base, model=search.base.model),
            final=replace(found.final, model=search.final.model),
        )

    def _promised(self, search: Search, gain: Gain) -> float:
        """Nats that held-out rows should gain if those searched did not by chance; 0 where that is no promise.

        Each parameter gains half a nat where it is fitted and loses as much elsewhere (Akaike 1974). Noise need
        not be the same there, and what comes with time only among the rows searched; never a pulse.
        """
        effects = [r.refits[0].effect for r in search.rounds if r.equivalent]
        if not all(_is_promise(effect, gain.among) for effect in effects):
            return 0.0
        gained = search.final.log_likelihood - search.base.log_likelihood
        further = len(search.final.free) - len(search.base.free)
        rows = int(self.searched.observed.any(axis=1).sum())
        # as many as there are in its time
        rows *= max(thinned_by(self.searched, self.records.main), 1)
        return (gained - further) * gain.samples / max(rows, 1)

    def _particle_word(self, base: QuasiFit, search: Search) -> tuple[str, bool]:
        """What the particle filter says of the gain, and whether it contradicts the moment filter."""
        final = search.final
        moment = final.log_likelihood - base.log_likelihood
        before, after = (base.model, base.theta), (final.model, final.theta)
        text, contradicts = particle_word(before, after, moment, self.searched, self.seed)
        # outliers were judged by a filter of their own
        return text, contradicts and not has_tails(search)


def _is_promise(effect: Effect, among: bool) -> bool:
    """Whether an effect found on rows says what others gain; ``among``: they lie among these."""
    lasting = effect.family == "time" and effect.traits.course not in (Course.PULSE, Course.EPISODE)
    return effect.family in FAMILIES or (among and lasting)
