#!/usr/bin/env bash
# One turn of the loop that begins with pictures: see, predict, drive, see again, learn, predict the way back.
#
#     examples/picture_loop.sh [FOLDER [SEED [RIG]]]
#
# As drive_loop.sh, but terrain, positions and depths of the ruts are those of SYNTHETIC pictures of a place that the twin
# does not know. With a real rover leave out `twin terrain synthetic`, `twin simulate` and `images render`. RIG is a name
# or a file of `images cameras` (yutu2-navcam). Stops where an answer is no-go or not to be trusted.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
folder=${1:-picture-loop}
seed=${2:-1}
rig=${3:-yutu2-navcam}
[ -f "$rig" ] && rig=$(realpath "$rig")
common=(--no-time --quiet)
mast=1.5 # m from the ground to the left camera, which is taken to be above the rover's origin
curvature=0.06
length=2.4

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

# Columns of the row of a CSV that is nearest to a time: FILE TIME COLUMN...
at_time() {
    awk -F, -v time="$2" -v wanted="${*:3}" '/^#/ { next } !head { for (k = 1; k <= NF; k++) at[$k] = k; head = 1; next }
        { off = $at["time_s"] - time; off = off < 0 ? -off : off; if (row == "" || off < least) { least = off; row = $0 } }
        END { split(row, cell); n = split(wanted, name, " ")
              for (k = 1; k <= n; k++) printf "%s%s", cell[at[name[k]]], (k < n ? " " : "\n") }' "$1"
}

# Pictures from a place: NAME X Y HEADING DOWN and further options of `images render`.
picture() {
    lunarsci images render ground/terrain.npz "${common[@]}" --rig "$rig" --x="$2" --y="$3" --heading="$4" --down="$5" \
        --height "$mast" --spacing 0.01 --rock-density 0.3 --rays 1 --exact-rig --seed "$seed" -o "$1" "${@:6}" >"$1.txt"
}

# Heights from the pictures of a folder, by a pose: NAME POSE and further options of `images dem`.
heights() {
    lunarsci images dem "$1/left.png" "$1/right.png" "${common[@]}" --rig "$rig" --pose "$2" --save-terrain "$1.npz" \
        "${@:3}" >"$1-heights.txt"
}

# A plan: NAME X Y HEADING CURVATURE and further lines of its leg.
plan() {
    printf 'name = "%s"\n[start]\nx_m = %s\ny_m = %s\nheading_deg = %s\n[drive]\nspeed_m_s = 0.05\n' "$1" "$2" "$3" "$4"
    printf '[[leg]]\nlength_m = %s\ncurvature_per_m = %s\n%s\n' "$length" "$5" "${6:-}"
    printf '[limits]\nslip_ratio = 0.3\nsinkage_m = 0.05\ntilt_deg = 20.0\nendpoint_miss_m = 3.0\n'
}

mkdir "$folder"
cd "$folder"

say "1. What the rover sees from where it stands, and where it may not drive"
lunarsci twin terrain synthetic "${common[@]}" --extent 16 --spacing 0.05 --seed "$seed" -o ground >ground.txt
picture A -3.2 0 0 25
heights A A/pose.toml
lunarsci images rocks A/left.png A/right.png "${common[@]}" --rig "$rig" --pose A/pose.toml -o rocks.geojson | head -n 3

say "2. Where will a drive lead, over all that is believed of lunar soil and of the heights?"
plan out 0 0 0 "$curvature" >out.toml
go_or_stop lunarsci twin predict out.toml "${common[@]}" --terrain A.npz --keep-out rocks.geojson \
    --sweep friction_angle_deg=33:41:3 --seed "$seed" -o 2-predicted >2-predicted.txt
sed -n 1p 2-predicted.txt

say "3. The drive (simulated on the true ground; the twin sees its telemetry, without positions, alone)"
drive=(lunarsci twin simulate out.toml "${common[@]}" --terrain ground/terrain.npz --soil "$here/hidden_soil.toml"
    --seed "$seed")
"${drive[@]}" -o 3-drive >3-drive.txt
# The same drive without errors of sensors: from where pictures are taken.
"${drive[@]}" --fix-sigma 1e-9 --fix-distance 0.05 --yaw-sigma 1e-9 -o 3-true >3-true.txt

say "4. Pictures on the way, and back to the ruts; dead reckoning says about where from"
end=$(awk -F, 'END { print $1 }' 3-drive/telemetry.csv)
for station in 0 1 2 3; do
    time=$(awk -v end="$end" -v k="$station" 'BEGIN { print end * k / 3 }')
    read -r time x y heading < <(at_time 3-true/telemetry.csv "$time" time_s x_m y_m yaw_deg)
    picture "S$station" "$x" "$y" "$heading" 25
    read -r told < <(at_time 3-drive/telemetry.csv "$time" yaw_deg)
    awk -v t="$time" -v c="$curvature" -v heading="$told" -v up="$mast" 'BEGIN {
        way = 0.05 * t; printf "position_m = [%.4f, %.4f, %.3f]\n", sin(c * way) / c, (1 - cos(c * way)) / c, up
        printf "heading_deg = %.3f\ndown_deg = 25.0\nroll_deg = 0.0\ntime_s = %s\n", heading, t }' >"S$station/pose.toml"
done
picture back "$x" "$y" "$(awk -v h="$heading" 'BEGIN { print h + 180 }')" 35 --track 3-true/truth.csv

say "5. From pictures to positions, a map and the depth of the ruts"
go_or_stop lunarsci images locate A S0 S1 S2 S3 "${common[@]}" --rig "$rig" -o 5-located
heights S2 5-located/S2.toml
grep -v '^S[013],' 5-located/shifts.csv >shifts.csv
lunarsci images merge A.npz S2.npz "${common[@]}" --positions shifts.csv -o map.npz >map.txt || [ $? -eq 3 ]
go_or_stop lunarsci twin states 3-drive/telemetry.csv out.toml "${common[@]}" --terrain map.npz \
    --positions 5-located/positions.csv -o 5-states >5-states.txt
# Looking back the mast has turned by half a turn.
awk -F' *= *' '$1 == "heading_deg" { $2 += 180 } $1 == "down_deg" { $2 = 35 } { print $1 " = " $2 }' \
    5-located/S3.toml >back.toml
heights back back.toml --spacing 0.01
for aside in 0.45 -0.45; do
    line=$(awk -F, -v aside="$aside" '!head { for (k = 1; k <= NF; k++) at[$k] = k; head = 1; next }
        NR % 8 == 2 { turn = $at["yaw_deg"] * atan2(0, -1) / 180
            printf "%s%.4f,%.4f", (n++ ? "," : ""), $at["x_m"] - aside * sin(turn), $at["y_m"] + aside * cos(turn) }' \
        5-states/motion.csv)
    lunarsci images track back.npz "${common[@]}" --line="$line" --search 0.1 --csv || [ $? -eq 3 ]
done | awk -F, 'NR == 1 || !/^distance_m/' >ruts.csv

say "6. From telemetry and pictures to slip and sinkage of every wheel, and what they say of the soil"
go_or_stop lunarsci twin states 3-drive/telemetry.csv out.toml "${common[@]}" --terrain map.npz \
    --positions 5-located/positions.csv --track ruts.csv -o 6-states --plot 6-states.png >6-states.txt
go_or_stop lunarsci twin update 6-states/states.csv "${common[@]}" --plan out.toml --terrain map.npz \
    --positions 6-states/positions.csv --seed "$seed" --save belief.json

say "7. The way back, predicted from that soil and, to compare, from what was believed before"
read -r x y heading < <(at_time 6-states/motion.csv 1e9 x_m y_m yaw_deg)
plan "way back" "$x" "$y" "$heading" "-$curvature" 'crab_deg = 180.0' >return.toml
go_or_stop lunarsci twin predict return.toml "${common[@]}" --terrain map.npz --keep-out rocks.geojson --soil belief.json \
    --seed "$seed" -o 7-predicted --plot 7-predicted.png >7-predicted.txt
sed -n 1p 7-predicted.txt
lunarsci twin predict return.toml "${common[@]}" --terrain map.npz --soil lunar-typical --seed "$seed" -o 7-unrectified \
    >7-unrectified.txt || [ $? -eq 3 ]

say "8. The return (simulated), and how right the prediction was"
lunarsci twin simulate return.toml "${common[@]}" --terrain ground/terrain.npz --soil "$here/hidden_soil.toml" \
    --seed "$((seed + 1))" -o 8-drive >8-drive.txt
go_or_stop lunarsci twin states 8-drive/telemetry.csv return.toml "${common[@]}" --terrain map.npz -o 8-states >8-states.txt
go_or_stop lunarsci twin compare 7-predicted 8-states/states.csv "${common[@]}" --positions 8-states/positions.csv \
    --plot 8-compared.png

after=$(lunarsci twin compare -q 7-predicted 8-states/states.csv --positions 8-states/positions.csv --field end.error_m)
before=$(lunarsci twin compare -q 7-unrectified 8-states/states.csv --positions 8-states/positions.csv \
    --field end.error_m 2>/dev/null) || [ $? -eq 3 ]
printf '\nThe return ended %.3f m from where it was predicted to, %.3f m from the prediction with a typical lunar soil.\n' \
    "$after" "$before"
