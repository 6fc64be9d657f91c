#!/usr/bin/env bash
# One episode of a test scenario, seen by cameras. Learns a library first where none was shipped.
set -euo pipefail
cd "$(dirname "$0")/.."

library=resync_robot/shipped/cornered-insertion-s
if [ ! -e "$library/library.json" ]; then
  library=runs/demo-training/library
  [ -e "$library/library.json" ] || resync-robot train-sim --preset quick --out runs/demo-training
fi
resync-robot deploy --backend sim --library "$library" --scenario s1 --episodes 1 --perception camera
