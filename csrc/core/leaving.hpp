// The end of the host: its other threads are asked to stop, then kept from it, as it is about to be gone.
#pragma once

#include <cstdint>

namespace pysas::leaving {

// Called by the thread that ends the host: others are to stop from now on; others may no longer return to the host.
void stop_others();
void keep_others();

// Whether the calling thread is to stop.
bool stopping();

// A thread that goes off from the host, and comes back: `back` does not return after keep_others. `home` once it is
// there.
void off();
void back();
void home();

// How many are off and not kept.
std::int64_t away();

}  // namespace pysas::leaving
