"""Every rule that admits, drops or demotes an effect, for evidence or for cost.

A candidate passes the gates in the order in which they stand here: whether it is sought, whether it
is worth a fit, whether its fit comes to an end, whether it enters, whether it stays, and whether it
is certain. `Journal.judge` records what a gate does with a candidate; `eitskin explain` reads that.
Gates that judge sets, pairs of names or the verdict are not recorded.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eitskin.quantities import MINUS, number

# Standard errors by which a gain of predictive density must exceed chance: p = 0.023, one-sided.
STANDARD_ERRORS = 2.0
SEARCH = "every candidate of the search"
MEMBER = "every effect of the set"


@dataclass(frozen=True)
class Gate:
    """One rule.

    statistic: what is compared, with its unit, or a condition, which is 1 where it holds, else 0;
    threshold: with which; passes: the side of the threshold on which a candidate passes;
    purpose: `scope` (what is sought), `cost` (what is worth a fit), `evidence` (what enters and
    stays), `certainty` (what is said without reserve); source: where the rule or its threshold
    comes from; applies_to: which candidates; refusal: a sentence with {value} and {threshold}.
    """

    name: str
    statistic: str
    threshold: float
    passes: str
    purpose: str
    source: str
    applies_to: str
    refusal: str

    @property
    def threshold_text(self) -> str:
        """The threshold with three digits at most."""
        return f"{self.threshold:.3g}".replace("-", MINUS)

    def refusal_text(self, value: float, place: str) -> str:
        """The refusal of a value; place: the other name, where the refusal has one."""
        return self.refusal.format(value=number(value), threshold=self.threshold_text, place=place)

    def admits(self, value: float) -> bool:
        """Whether a value of the statistic passes; NaN does not."""
        return {
            "above": value > self.threshold,
            "at least": value >= self.threshold,
            "below": value < self.threshold,
            "at most": value <= self.threshold,
        }[self.passes]


COMPOSED = Gate(
    "composed",
    "the effect is no combination of others",
    1,
    "at least",
    "scope",
    "definition of the catalogue",
    "effects of the catalogue",
    "it is a combination of other effects, which a diagnosis names instead",
)
CONTACTS = Gate(
    "contacts",
    "the electrodes are no points",
    1,
    "at least",
    "scope",
    "complete electrode model: a point has no contact",
    "effects on contacts",
    "the electrodes are stated to be points, which have no contact with the gel",
)
STATED = Gate(
    "stated",
    "the skin's metadata state what the effect needs, or nobody touches",
    1,
    "at least",
    "scope",
    "definition of the effect (`needs`)",
    "effects of a body, where somebody touches",
    "the skin's metadata do not state what it needs where somebody touches",
)
MODELLED = Gate(
    "modelled",
    "the effect is modelled on a skin of this outline, with these electrodes",
    1,
    "at least",
    "scope",
    "definition of the effect (`on_outlines`, `beside_inner`)",
    "effects of a body, a gradient of the conductivity, and a direction beside electrodes inside",
    "it is not modelled on this outline, or not beside electrodes inside the skin",
)
TIMED = Gate(
    "timed",
    "the clock of the recording was measured",
    1,
    "at least",
    "scope",
    "a time that nobody measured tells no rate",
    "effects driven by time",
    "the recording's times were not measured",
)
FLOATING = Gate(
    "floating",
    "the source floats",
    1,
    "at least",
    "scope",
    "definition of the effect",
    "another instrument than the owner's",
    "it is sought only where the current source floats",
)
GROSS_MISFIT = Gate(
    "gross-misfit",
    "chi squared a degree of freedom against noise alone",
    30.0,
    "above",
    "scope",
    "thirty times the noise's variance is seen by eye",
    "gross faults of the wiring; another instrument than the owner's",
    "chi squared a degree of freedom is {value}; it is tried first only above {threshold}",
)
UNLIKE = Gate(
    "unlike",
    "squared correlation of readings and simulation",
    0.3,
    "below",
    "scope",
    "channels in an order of their own correlate by chance",
    "another instrument than the owner's",
    "the squared correlation of readings and simulation is {value}; another instrument is sought"
    " only below {threshold}",
)
SIGNATURE = Gate(
    "signature",
    "the effect changes some reading, beyond what the calibrations and the set take",
    1,
    "at least",
    "cost",
    "a column of zeros has no score",
    SEARCH,
    "it changes nothing in these readings that the calibrations and the named effects do not",
)
LINE = Gate(
    "line",
    "probability that noise as strong as at the frequencies around has a line of such power",
    1e-3,
    "below",
    "evidence",
    "exponential distribution of a periodogram, over all independent frequencies; as `chance`",
    "tones",
    "noise as strong as at the frequencies around it has a line of such power in {value} of"
    " recordings; a tone is below {threshold}",
)
REACH = Gate(
    "reach",
    "squared length of the effect's change over chi squared",
    16.0,
    "at most",
    "cost",
    "triangle inequality: a change of four times the residual's length cannot shorten it",
    "effects that are there or not",
    "its change is {value} times chi squared; one of more than {threshold} times cannot lower it",
)
SURPRISE = Gate(
    "surprise",
    "global p-value of the best score of all candidates",
    0.05,
    "below",
    "cost",
    "a fit costs some hundred scores; the level of a first look",
    SEARCH,
    "the best score of all names has a p-value of {value} over the whole catalogue; below"
    " {threshold} names are fitted",
)
HOPE = Gate(
    "hope",
    "linear log evidence of the best score of all candidates, nats",
    1.0,
    "above",
    "cost",
    "Kass, Raftery (1995): less than one nat is hardly worth mentioning",
    SEARCH,
    "the best score of all names has a log evidence of {value} nats; above {threshold} names are"
    " fitted",
)
NAMES = Gate(
    "names",
    "rank of the name's best score",
    12,
    "at most",
    "cost",
    "a third of the catalogue; later names lost in every calibration block",
    SEARCH,
    "its score has rank {value} of all names; ranks up to {threshold} are fitted",
)
NEAR_BEST = Gate(
    "near-best",
    "linear log evidence above the best score's, nats",
    -20.0,
    "above",
    "cost",
    "a tangent's evidence is off by some nats, seldom by twenty",
    SEARCH,
    "its score is {value} nats from the best one; a name is fitted from {threshold} on",
)
GAIN_SHARE = Gate(
    "gain-share",
    "gain of chi squared over the largest of all scores",
    0.3,
    "above",
    "cost",
    "one effect may hide another of a third of its size",
    SEARCH,
    "its gain of chi squared is {value} of the largest; a name is fitted above {threshold}",
)
AMPLITUDE = Gate(
    "amplitude",
    "gain of chi squared",
    0.0,
    "above",
    "cost",
    "what shows at large readings alone weighs little in a tangent",
    "effects driven by amplitude",
    "its score gains {value} of chi squared",
)
ABSORBED = Gate(
    "absorbed",
    "global p-value where one error of the rig is left out of the covariance",
    1e-3,
    "below",
    "cost",
    "as `chance`",
    "names that an error of the rig may have taken to itself",
    "without the error of the rig that may hide it, its p-value is {value}; a name is fitted below"
    " {threshold}",
)
COMPETING = Gate(
    "competing",
    "rank among the names that one error of the rig may hide",
    2,
    "at most",
    "cost",
    "more of them seldom end better and cost a fit each",
    "names that an error of the rig may have taken to itself",
    "it has rank {value} of the names that one error of the rig may hide; ranks up to {threshold}"
    " are fitted",
)
SITES = Gate(
    "sites",
    "sites of one sparse effect",
    8,
    "at most",
    "cost",
    "half of sixteen electrodes: more is called dense",
    "effects that are there at other sites",
    "it would be at {value} sites; {threshold} are called sparse",
)
ENTRY = Gate(
    "entry",
    "the set has no entry of this name from this start",
    1,
    "at least",
    "scope",
    "diagnosis.json has one entry of a name, unless its definition allows several",
    SEARCH,
    "the diagnosis names it already",
)
BUDGET = Gate(
    "budget",
    "sheets solved so far, over those that one diagnosis may solve",
    1.0,
    "at most",
    "cost",
    "minutes on one core",
    SEARCH,
    "as many skins were solved as one diagnosis may solve",
)
PHYSICS = Gate(
    "physics",
    "the fit meets only skins that exist",
    1,
    "at least",
    "cost",
    "no solution of the forward problem",
    SEARCH,
    "its fit led to a skin that the physics does not have",
)
ASTRAY = Gate(
    "astray",
    "nats by which a fit ends behind the one that it began from",
    100.0,
    "at most",
    "cost",
    "more freedom cannot fit worse: the fit went astray",
    SEARCH,
    "its fit ended {value} nats behind the one without it, and was given up",
)
RACE = Gate(
    "race",
    "nats behind the best trial at which a fit is given up",
    10.0,
    "at most",
    "cost",
    "ten nats are odds of 22,000",
    SEARCH,
    "its fit fell {value} nats behind the best name's, and was given up",
)
STARTS = Gate(
    "starts",
    "rank of a start of the name, by the chi squared that it leaves",
    3,
    "at most",
    "cost",
    "a fit of a body costs as much as some hundred sheets",
    "effects that no tangent leads to, where nobody touches",
    "its start has rank {value} of the name; ranks up to {threshold} are fitted",
)
AGAIN = Gate(
    "again",
    "nats by which it was behind beside fewer effects",
    5.0,
    "at most",
    "cost",
    "a trial of a body takes seconds, of a tangent none",
    "effects that no tangent leads to, where nobody touches",
    "it was behind by {value} nats beside fewer effects; beyond {threshold} it is not tried again",
)
FORLORN = Gate(
    "forlorn",
    "nats by which a fit without its discrepancy is behind after one step, with what the next step"
    " promises",
    150.0,
    "at most",
    "cost",
    "odds that no further step makes up for",
    "sets with a discrepancy in their covariance, which are tried without it as well",
    "without a discrepancy its fit is {value} nats behind; it is followed up to {threshold}",
)
GROSS_SHARE = Gate(
    "gross-share",
    "misfit that a gross fault leaves, over that without it",
    0.5,
    "at most",
    "cost",
    "half of a gross misfit is plain to see",
    "gross faults of the wiring, before anything else is tried",
    "it leaves {value} of the misfit; a gross fault is plain up to {threshold}",
)
EVIDENCE = Gate(
    "evidence",
    "log evidence above that without the effect, or the site, nats",
    3.0,
    "at least",
    "evidence",
    "Kass, Raftery (1995): from three nats on evidence is strong",
    SEARCH,
    "it raises the log evidence by {value} nats; an effect must raise it by {threshold}",
)
CHANCE = Gate(
    "chance",
    "global p-value: how often chance alone gives so good a score, over all that is looked at",
    1e-3,
    "below",
    "evidence",
    "one false name in a thousand recordings",
    SEARCH,
    "chance alone gives so good a score, over the whole catalogue, in {value} of recordings; an"
    " effect enters below {threshold}",
)
PREDICTION = Gate(
    "prediction",
    f"log density of the folds left out, less {STANDARD_ERRORS:g} standard errors, above that"
    " without the effect, nats",
    0.0,
    "above",
    "evidence",
    "Vehtari, Gelman, Gabry (2017): a difference within two standard errors is none",
    SEARCH,
    f"frames left out are predicted better by {{value}} nats once {STANDARD_ERRORS:g} standard"
    " errors are taken off; an effect enters above {threshold}",
)
EFFECTS_OF_A_SET = Gate(
    "effects-of-a-set",
    "effects that the set has",
    5,
    "below",
    "cost",
    "a recording of some hundred frames has never told more of them",
    SEARCH,
    "the set has {value} effects; no more than {threshold} are sought",
)
CATCH_UP = Gate(
    "catch-up",
    "nats that the set would lack of its rival's log evidence, if as many effects as may still come"
    " were each as good as the last",
    0.0,
    "at most",
    "cost",
    "later effects seldom raise the evidence by more than earlier ones",
    "sets that grow beside a rival",
    "the set would still lack {value} nats of its rival's log evidence",
)
PLACE = Gate(
    "place",
    "log evidence above the effect whose place is taken, nats",
    1.0,
    "above",
    "evidence",
    "Kass, Raftery (1995): less than one nat is hardly worth mentioning",
    "other names in an effect's place",
    "in the place of {place} it has {value} nats more; another name takes a place above"
    " {threshold}",
)
SIZE = Gate(
    "size",
    "sd of the logarithm of the effect's size",
    float(np.log(100.0) / (2.0 * 1.6449)),
    "below",
    "evidence",
    "a 90 % interval whose ends differ a hundredfold tells no size",
    "another instrument than the owner's",
    "its size is uncertain by {value} in its logarithm; it is named below {threshold}",
)
FREEDOM = Gate(
    "freedom",
    "log evidence above that of sets with less freedom, nats",
    0.0,
    "at least",
    "evidence",
    "Occam: many free values take what several plain effects explain together",
    "sets with a free value at every site, or at more than two sites",
    "a set of fewer free values has a log evidence of {value} nats less",
)
FOLDS = Gate(
    "folds",
    f"log density of the folds left out, less {STANDARD_ERRORS:g} standard errors, above that"
    " without the effect, nats",
    0.0,
    "at least",
    "evidence",
    "Vehtari, Gelman, Gabry (2017)",
    MEMBER,
    f"beside the final set, frames left out are predicted better by {{value}} nats once"
    f" {STANDARD_ERRORS:g} standard errors are taken off; it stays from {{threshold}} on",
)
PRESSES = Gate(
    "presses",
    "log density of the presses left out above that without the effect, less its standard error by"
    " the scatter over presses, nats",
    0.0,
    "at least",
    "evidence",
    "what some presses gain and others lose may go either way in the next",
    MEMBER,
    "over presses its gain less its standard error is {value} nats; it stays from {threshold} on",
)
HARM_RATIO = Gate(
    "harm-ratio",
    "rms error of the readings left out, over that without the effect",
    1.05,
    "at most",
    "evidence",
    "a twentieth more error is seen at the bench",
    MEMBER,
    "with it the rms error of readings left out is {value} times as large; it stays up to"
    " {threshold}",
)
HARM_ERRORS = Gate(
    "harm-errors",
    "standard errors by which the squared error of the readings left out grows",
    STANDARD_ERRORS,
    "at most",
    "evidence",
    "a growth within two standard errors is none",
    MEMBER,
    "with it the squared error of readings left out grows by {value} standard errors; it stays up"
    " to {threshold}",
)
RANGE = Gate(
    "range",
    "largest share of the range of a size that its 90 % interval holds",
    0.9,
    "at most",
    "evidence",
    "an interval that holds nearly every value that a size may have tells none",
    MEMBER,
    "the 90 % interval of its size holds {value} of all values that it may have; it stays up to"
    " {threshold}",
)
CULPRIT = Gate(
    "culprit",
    "probability of one so far out of the family of its name, over all its sites",
    1e-3,
    "below",
    "evidence",
    "node splitting (Dias et al., Statistics in Medicine 29, 2010); of a null, one in a thousand",
    "effects of the set at sites of a family, which predicts folds as well without a name",
    "a member so far out of its family has a probability of {value}; it stands out below"
    " {threshold}",
)
FAMILY = Gate(
    "family",
    "nats of marginal likelihood with a family and all that it cannot be told from, its size free",
    5.0,
    "at least",
    "evidence",
    "a likelihood ratio of a size that may be 0 is half a chi squared of one (Self, Liang, JASA 82,"
    " 1987): 5 nats are p = 0.0008, of eight families 0.006",
    "families, which the verdict counts and the report tells",
    "its family is worth {value} nats; it is told from {threshold} on",
)
FAMILIES_PREDICT = Gate(
    "families-predict",
    "squared misfit of the readings left out with all families, over that without a name",
    0.5,
    "at most",
    "evidence",
    "as `gross-share`: free values at every site take some of any misfit, and predict none of it",
    "families that leave a gross misfit (`gross-misfit`)",
    "with them {value} of the squared misfit of readings left out stays; families are told up to"
    " {threshold} where a gross misfit stays",
)
SURE_GAIN = Gate(
    "sure-gain",
    f"log density of the folds left out, less {STANDARD_ERRORS:g} standard errors, above that of"
    " the best set without the effect, another name in its place too, nats",
    0.0,
    "above",
    "certainty",
    "Vehtari, Gelman, Gabry (2017): a difference within two standard errors is none",
    MEMBER,
    f"beside the best set without it, frames left out are predicted better by {{value}} nats once"
    f" {STANDARD_ERRORS:g} standard errors are taken off; it is certain above {{threshold}}",
)
STANDS_OUT = Gate(
    "stands-out",
    "length of the effect's signature, the calibrations and the other effects fitted to it, noise"
    " units",
    3.0,
    "at least",
    "certainty",
    "as `distinct`: calibrations are names too",
    MEMBER,
    "beyond what the calibrations can do its signature is {value} noise units long; it is certain"
    " from {threshold} on",
)
DISTINCT = Gate(
    "distinct",
    "SNR gap between an effect and another name, noise units",
    3.0,
    "at least",
    "certainty",
    "contract of diagnosis.json: a gap under 3 does not tell two names apart",
    "every effect of the set, with the nearest other name",
    "its gap to {place} is {value}; names are told apart from {threshold} on",
)
CLEARLY_DISTINCT = Gate(
    "clearly-distinct",
    "SNR gap between an effect and another name, noise units",
    5.0,
    "at least",
    "certainty",
    "a gap of 3 to 5 is confused by noise in some cases of a hundred",
    "pairs of an effect and another name, for the next experiment",
    "its gap to {place} is {value}; it is clear from {threshold} on",
)
SIZE_INTERVAL = Gate(
    "size-interval",
    "probability of the widest interval of the effect's size that leaves out the value of no"
    " effect; of values at several sites, a common one",
    0.9,
    "above",
    "certainty",
    "contract of diagnosis.json: 90 % intervals",
    "effects that some value turns into none",
    "the 90 % interval of its size holds the value of no effect: that of {value} ends there",
)
STATED_SIZE = Gate(
    "stated-size",
    "no stated 90 % interval of the effect's size holds the value of no effect",
    1,
    "at least",
    "certainty",
    "what is stated must not contradict what is called certain",
    "effects that some value turns into none",
    "the 90 % interval that is stated of its size holds the value of no effect",
)
ACCEPTABLE = Gate(
    "acceptable",
    "p-value of the chi squared of the folds left out",
    0.01,
    "above",
    "certainty",
    "contract of diagnosis.json: p > 0.01",
    MEMBER,
    "the fit as a whole is not acceptable: its p-value is {value}; effects are certain above"
    " {threshold}, or where the misfit does not touch them",
)
UNAFFECTED = Gate(
    "unaffected",
    "p-value of the squared length of the misfit along the effect's signature, channel by channel"
    " and press by press",
    0.01,
    "above",
    "certainty",
    "as `acceptable`; White (1980): what a misfit does to an estimate",
    "effects of a fit that is not acceptable",
    "the misfit touches it: along its signature it is as long as by chance in {value} of"
    " recordings; it is apart from the misfit above {threshold}",
)
REMAINDER = Gate(
    "remainder",
    "SNR gap to the nearest distinct name, less the length of what has no name, noise units",
    0.0,
    "at least",
    "certainty",
    "what has no name might tell the two names apart, if it is as long as the gap",
    "effects beside a likely remainder",
    "what has no name exceeds the gap to the nearest other name by as much: {value}",
)
ELSEWHERE = Gate(
    "elsewhere",
    "sites at which both the effect and what has no name are",
    0,
    "at most",
    "certainty",
    "what is left at a site may be what its value stands for",
    "effects beside a likely remainder",
    "what has no name is at {value} of its sites",
)
NOTHING_UNNAMED = Gate(
    "nothing-unnamed",
    "probability that something outside the catalogue is present",
    0.5,
    "below",
    "certainty",
    "contract of diagnosis.json",
    "the verdict",
    "the probability of something without a name is {value}",
)
FAMILY_COUNTS = Gate(
    "family-counts",
    "share of the held-out misfit that comes back without the family",
    0.05,
    "at least",
    "certainty",
    "contract of diagnosis.json",
    "the verdict",
    "without the family {value} of the misfit comes back; a family counts for the verdict from"
    " {threshold} on",
)
OBSERVABLE = Gate(
    "observable",
    "SNR of an effect of typical size, noise units",
    3.0,
    "at least",
    "scope",
    "as `distinct`: below it the effect would look like none",
    "names that are not found",
    "at a typical size it would stand out by {value} noise units; it can be shown from"
    " {threshold} on",
)


def every() -> Iterator[Gate]:
    """All gates, in the order in which a candidate meets them."""
    yield from (value for value in globals().values() if isinstance(value, Gate))
