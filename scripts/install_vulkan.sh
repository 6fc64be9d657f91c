#!/usr/bin/env bash
# Gives SAPIEN something to render with. A machine with NVIDIA's Vulkan driver needs nothing; any other one
# renders on the CPU through Mesa's lavapipe, from version 24.3 on (22.3 fails to find a rendering device).
# On Debian 12 that version is in bookworm-backports, added here with the mirror that apt already uses.
set -euo pipefail

wanted="24.3"
packages=()

have_nvidia() {
  nvidia-smi >/dev/null 2>&1 && ls {/usr/share,/etc}/vulkan/icd.d/nvidia*.json >/dev/null 2>&1
}
have_mesa() {
  local version
  version=$(dpkg-query -W -f='${Version}' mesa-vulkan-drivers 2>/dev/null) || return 1
  dpkg --compare-versions "$version" ge "$wanted" && dpkg -s libvulkan1 >/dev/null 2>&1
}

if ! command -v apt-get >/dev/null 2>&1; then
  have_nvidia && exit 0
  echo "Vulkan: install libX11, libvulkan and Mesa >= $wanted (lavapipe) with this system's package manager" >&2
  exit 1
fi
# SAPIEN links against libX11 even where it opens no window.
dpkg -s libx11-6 >/dev/null 2>&1 || packages+=(libx11-6)
have_nvidia || have_mesa || packages+=(mesa-vulkan-drivers libvulkan1)
if [ ${#packages[@]} = 0 ]; then
  echo "Vulkan: a driver is present, nothing to install"
  exit 0
fi

as_root=()
if [ "$(id -u)" != 0 ]; then
  if ! sudo -n true 2>/dev/null; then
    echo "Vulkan: root is needed once, for ${packages[*]}. Run:  sudo bash scripts/install_vulkan.sh" >&2
    exit 1
  fi
  as_root=(sudo -n)
fi

"${as_root[@]}" apt-get update -qq
release=()
if [[ " ${packages[*]} " == *" mesa-vulkan-drivers "* ]]; then
  candidate=$(LC_ALL=C apt-cache policy mesa-vulkan-drivers | awk '/Candidate:/ {print $2}')
  if ! dpkg --compare-versions "${candidate:-0}" ge "$wanted"; then
    # shellcheck disable=SC1091
    codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
    if [ "$codename" != bookworm ]; then
      echo "Vulkan: this release offers Mesa ${candidate:-none}; to render without a GPU, add a source of >= $wanted" >&2
      exit 1
    fi
    # Codename and address of what apt already fetches from; the security and updates archives lie elsewhere.
    mirror=$(apt-get indextargets --format '$(CODENAME) $(REPO_URI)' | awk -v c="$codename" '$1 == c {print $2; exit}')
    : "${mirror:?Vulkan: apt knows no Debian mirror; add one to /etc/apt/sources.list first}"
    printf 'deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] %s %s-backports main\n' "$mirror" "$codename" |
      "${as_root[@]}" tee /etc/apt/sources.list.d/resync-robot-backports.list >/dev/null
    "${as_root[@]}" apt-get update -qq
    release=(-t "$codename-backports")
  fi
fi
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
  "${release[@]}" "${packages[@]}" >/dev/null
have_nvidia || have_mesa || { echo "Vulkan: Mesa >= $wanted did not install" >&2; exit 1; }
echo "Vulkan: installed ${packages[*]}"
