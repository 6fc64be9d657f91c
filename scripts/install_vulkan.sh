#!/usr/bin/env bash
# Gives SAPIEN something to render with. A machine with an NVIDIA driver needs nothing; any other one
# renders on the CPU through Mesa's lavapipe, from version 24.3 on (22.3 fails to find a rendering device).
# On Debian 12 that version is in bookworm-backports, added here with the mirror that apt already uses.
set -euo pipefail

wanted="24.3"

have_mesa() {
  local version
  version=$(dpkg-query -W -f='${Version}' mesa-vulkan-drivers 2>/dev/null) || return 1
  dpkg --compare-versions "$version" ge "$wanted"
}

if command -v nvidia-smi >/dev/null 2>&1 && nvidia-smi >/dev/null 2>&1; then
  echo "Vulkan: an NVIDIA driver is present, nothing to install"
  exit 0
fi
if have_mesa && dpkg -s libvulkan1 >/dev/null 2>&1; then
  echo "Vulkan: Mesa $(dpkg-query -W -f='${Version}' mesa-vulkan-drivers) is present"
  exit 0
fi
if ! command -v apt-get >/dev/null 2>&1; then
  echo "Vulkan: install libvulkan and Mesa >= $wanted (the lavapipe driver) with this system's package manager" >&2
  exit 1
fi

as_root=""
if [ "$(id -u)" != 0 ]; then
  if command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root="sudo"
  else
    echo "Vulkan: root is needed once. Run:  sudo bash scripts/install_vulkan.sh" >&2
    exit 1
  fi
fi

$as_root apt-get update -qq
candidate=$(apt-cache policy mesa-vulkan-drivers | awk '/Candidate:/ {print $2}')
release=()
if ! dpkg --compare-versions "${candidate:-0}" ge "$wanted"; then
  # shellcheck disable=SC1091
  codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
  if [ "$codename" != bookworm ]; then
    echo "Vulkan: this release offers Mesa ${candidate:-none}; version >= $wanted is needed to render without a GPU" >&2
    exit 1
  fi
  mirror=$(apt-get indextargets --format '$(RELEASE) $(REPO_URI)' | awk -v c="$codename" '$1 == c || $1 == "stable" || $1 == "oldstable" {print $2; exit}')
  : "${mirror:?Vulkan: apt knows no Debian mirror; add one to /etc/apt/sources.list first}"
  keyring=/usr/share/keyrings/debian-archive-keyring.gpg
  printf 'deb [signed-by=%s] %s %s-backports main\n' "$keyring" "$mirror" "$codename" |
    $as_root tee /etc/apt/sources.list.d/resync-robot-backports.list >/dev/null
  $as_root apt-get update -qq
  release=(-t "$codename-backports")
fi
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${release[@]}" \
  mesa-vulkan-drivers libvulkan1 >/dev/null
have_mesa || { echo "Vulkan: Mesa >= $wanted did not install" >&2; exit 1; }
echo "Vulkan: Mesa $(dpkg-query -W -f='${Version}' mesa-vulkan-drivers) installed"
