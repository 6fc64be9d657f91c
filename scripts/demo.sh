#!/usr/bin/env bash
# One episode of a test scenario, seen by cameras. Learns a library first where none was shipped.
set -euo pipefail
cd "$(dirname "$0")/.."

out=runs/demo
library=resync_robot/shipped/cornered-insertion-s
if [ ! -e "$library/library.json" ]; then
  library=$out/training/library
  [ -e "$library/library.json" ] || resync-robot train-sim --preset quick --out "$out/training"
fi
resync-robot deploy --backend sim --library "$library" --scenario s1 --episodes 1 --perception camera --out "$out/episodes"
echo
echo "The recording is in $out/episodes. Look at it:"
for episode in "$out"/episodes/*; do
  echo "  .venv/bin/resync-robot review $episode"
done
