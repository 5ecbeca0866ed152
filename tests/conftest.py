"""Settings of every test: by default properties are tested on the same examples wherever and
whenever they are run; the profile `search` draws others, of the seed that it is given."""

from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers

# Machines differ in speed, and so would what a health check of it says.
untimed = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("same", derandomize=True, database=None, print_blob=True, **untimed)
settings.register_profile(
    "search", derandomize=False, database=None, print_blob=True, max_examples=300, **untimed
)
settings.load_profile("same")

# Hypothesis draws constants of whatever modules are imported by then, by where they lie: examples
# would depend on the test before and on the folder's name.
providers.HypothesisProvider._local_constants = providers.Constants()
