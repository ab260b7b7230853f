"""From healthy flights to a baseline."""

from mavdiag.learning.flights import LearntFlight as LearntFlight
from mavdiag.learning.flights import airborne as airborne
from mavdiag.learning.flights import front_for as front_for
from mavdiag.learning.flights import rows_of as rows_of
from mavdiag.learning.learn import ALL_MONITORS as ALL_MONITORS
from mavdiag.learning.learn import LearnOptions as LearnOptions
from mavdiag.learning.learn import extend as extend
from mavdiag.learning.learn import learn as learn
from mavdiag.learning.learn import thesis_options as thesis_options
from mavdiag.learning.learn import warm as warm
