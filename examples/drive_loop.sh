#!/usr/bin/env bash
# One turn of the loop: predict a drive, drive it, learn the soil from its telemetry, choose and predict the way back.
#
#     examples/drive_loop.sh [FOLDER [SEED]]
#
# The rover is simulated on a soil that the twin does not know (hidden_soil.toml), with errors of its sensors drawn from
# SEED; with real telemetry leave out the two commands `twin simulate`. Everything is written to FOLDER, which must not
# exist; the same seed gives the same bytes. Stops where a prediction says no-go or telemetry cannot be trusted.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
folder=${1:-drive-loop}
seed=${2:-1}
common=(--no-time --quiet)

say() { printf '\n== %s\n' "$*"; }

# Exit code 3: there is a result, but it says no-go or is not to be trusted.
go_or_stop() {
    local status=0
    "$@" || status=$?
    if [ "$status" -eq 3 ]; then
        echo "stopped: $1 $2 $3 gives no go-ahead (exit code 3), see above" >&2
    fi
    return "$status"
}

mkdir "$folder"
cd "$folder"

say "1. Before the drive: where will it lead, over all that is believed of lunar soil?"
go_or_stop lunarsci twin predict "${common[@]}" --seed "$seed" -o 1-predicted >1-predicted.txt
sed -n 1p 1-predicted.txt

say "2. The drive (simulated; the twin sees its telemetry alone)"
lunarsci twin simulate "${common[@]}" --soil "$here/hidden_soil.toml" --seed "$seed" -o 2-drive >2-drive.txt

say "3. From telemetry to slip, side slip and sinkage of every wheel"
go_or_stop lunarsci twin states "${common[@]}" 2-drive/telemetry.csv --track 2-drive/track.csv \
    -o 3-states --plot 3-states.png

say "4. From states to the forces of every wheel"
go_or_stop lunarsci twin loads "${common[@]}" --motion 3-states/motion.csv --states 3-states/states.csv \
    --seed "$seed" --csv >4-forces.csv
head -n 3 4-forces.csv

say "5. From forces to the mechanical properties of the soil"
lunarsci regolith infer "${common[@]}" --seed "$seed" - <4-forces.csv

say "6. What the whole drive says of the soil, kept for the next one"
go_or_stop lunarsci twin update "${common[@]}" 3-states/states.csv --positions 3-states/positions.csv \
    --seed "$seed" --save belief.json

say "7. The way back: chosen over that soil, predicted, and, to compare, predicted from what was believed before"
# From where the rover stands now, the last row of the smoothed motion, to where it began. Slopes take it aside: drives
# may halt for a minute to be localised to 5 cm; an end within 3 m counts as there.
stands=$(awk -F, 'NR == 1 { for (k = 1; k <= NF; k++) at[$k] = k } END {
    printf "%.4f,%.4f,%.3f", $at["x_m"], $at["y_m"], $at["yaw_deg"] }' 3-states/motion.csv)
go_or_stop lunarsci twin plan "${common[@]}" --start="$stands" --target 0,0 --tolerance 3 --soil belief.json \
    --risk 0.1 --candidates 4 --fixes 0.05,0.5,60 --seed "$seed" -o 7-chosen >7-chosen.txt
sed -n 1p 7-chosen.txt
cp 7-chosen/plan.toml return.toml
go_or_stop lunarsci twin predict "${common[@]}" return.toml --soil belief.json --seed "$seed" -o 7-predicted \
    >7-predicted.txt
sed -n 1p 7-predicted.txt
lunarsci twin predict "${common[@]}" return.toml --soil lunar-typical --seed "$seed" -o 7-unrectified \
    >7-unrectified.txt || [ $? -eq 3 ]

say "8. The return (simulated), and how right the prediction was"
lunarsci twin simulate "${common[@]}" return.toml --soil "$here/hidden_soil.toml" --seed "$((seed + 1))" -o 8-drive \
    >8-drive.txt
go_or_stop lunarsci twin states "${common[@]}" 8-drive/telemetry.csv return.toml --track 8-drive/track.csv \
    -o 8-states >8-states.txt
go_or_stop lunarsci twin compare "${common[@]}" 7-predicted 8-states/states.csv --positions 8-states/positions.csv \
    --plot 8-compared.png

say "9. All of it on one page"
compared=(lunarsci twin compare 7-predicted 8-states/states.csv --positions 8-states/positions.csv)
"${compared[@]}" "${common[@]}" -o 8-compared.json 2>/dev/null || [ $? -eq 3 ]
lunarsci report "${common[@]}" 1-predicted 3-states 7-chosen 7-predicted 8-states 8-compared.json 3-states.png \
    8-compared.png --title "One turn of the loop" -o loop.html && echo "open $folder/loop.html in a browser" ||
    echo "no page: it needs jinja2; pip install 'lunarsci[report]'"

after=$(lunarsci twin compare -q 7-predicted 8-states/states.csv --positions 8-states/positions.csv --field end.error_m)
before=$(lunarsci twin compare -q 7-unrectified 8-states/states.csv --positions 8-states/positions.csv \
    --field end.error_m 2>/dev/null) || [ $? -eq 3 ]
printf '\nThe return ended %.3f m from where it was predicted to, %.3f m from the prediction with a typical lunar soil.\n' \
    "$after" "$before"
