#!/bin/sh
# From a recorder's files to an image without a line of Python; examples/recorder.py does the same and says what the files hold.
#
#     sh examples/recorder.sh FOLDER [OUTPUT]
#
# --pulse-centre 0 is for this recording, a simulation in which all of a pulse leaves from where the transmitter is at its leading
# edge; a sonar moves meanwhile: leave the option out.
set -eu
from=$1
to=${2:-.}

pysas echoes --samples "$from/adc.bin" --dtype '<i2' --shape 110 16 2600 --pulse "$from/replica.wav" \
    --fs "$from/survey.mat:fs" --c "$from/survey.mat:c" --t0 "$from/survey.mat:t_delay" --fc 100e3 --bandwidth 36e3 \
    --nav "$from/nav.csv" --pings "$from/pings.csv" --levers "$from/levers.csv" --pulse-centre 0 -o "$to/line.npz"
pysas check "$to/line.npz"
pysas image "$to/line.npz" --z 20 --x -3:3 --y 22.3:25.6 --spacing 0.01 -o "$to/image.npz" --png "$to/image.png"
