"""What was measured: experiments, campaigns, their files and their faults."""

from hsed_jax.measurements.at2 import read_at2 as read_at2
from hsed_jax.measurements.at2 import write_at2 as write_at2
from hsed_jax.measurements.campaign import Campaign as Campaign
from hsed_jax.measurements.characteristics import Characteristics as Characteristics
from hsed_jax.measurements.characteristics import characteristics as characteristics
from hsed_jax.measurements.checks import Finding as Finding
from hsed_jax.measurements.checks import check_campaign as check_campaign
from hsed_jax.measurements.checks import noise_estimate as noise_estimate
from hsed_jax.measurements.checks import stop_at_errors as stop_at_errors
from hsed_jax.measurements.experiment import Channel as Channel
from hsed_jax.measurements.experiment import Experiment as Experiment
from hsed_jax.measurements.experiment import Noise as Noise
from hsed_jax.measurements.experiment import Record as Record
from hsed_jax.measurements.histories import read_history as read_history
from hsed_jax.measurements.overview import overview as overview
from hsed_jax.measurements.pairs import pair_of as pair_of
from hsed_jax.measurements.readers import read_campaign as read_campaign
from hsed_jax.measurements.records import Found as Found
from hsed_jax.measurements.records import numeric_columns as numeric_columns
from hsed_jax.measurements.thinning import half_cycles as half_cycles
from hsed_jax.measurements.units import Unit as Unit
from hsed_jax.measurements.units import parse_unit as parse_unit
from hsed_jax.measurements.writers import write_campaign as write_campaign
from hsed_jax.measurements.writers import write_experiment as write_experiment
