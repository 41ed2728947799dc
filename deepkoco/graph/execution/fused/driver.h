// The loop over steps and slots. What runs when comes from tables; `BODIES` says what a node does.
//
// A block holds W environments. Its fixed record (environments, schedule rows, parameters, states that never
// change) is read, its moving record (step, states, readings, last outputs) is written.

// Not inlined, so that the buffers of only one of them are on the stack at a time.
#define APART static __attribute__((noinline))

INLINE i32 seq_at(const Model &m, i64 row, i64 step, i64 slot) {
  const i64 at = (row * (m.steps + 1) + step) * m.slots + slot;
  return m.small_table ? ((const int16_t *)m.table)[at] : ((const i32 *)m.table)[at];
}
INLINE double seconds(i64 ticks, const Model &m) { return double(ticks) / m.resolution; }

template <class V> static void pick_as(const char *ring, i64 bytes, i32 mask, VI cell, unsigned present, i64 count, char *out) {
  for (i64 k = 0; k < count; k++) {
    V r = ld<V>(ring, k);
    for (i32 q = 0; q <= mask; q++)
      if (present >> q & 1) r = sel(eq(cell, splat<VI>(q)), ld<V>(ring + q * bytes, k), r);
    st(out, k, r);
  }
}
// Each lane's own cell of a ring.
static void pick(const char *ring, i64 bytes, i32 mask, const i32 *cell, i64 count, i64 size, char *out) {
  if (mask < 16 && size >= 4) {
    unsigned present = 0;
    for (int l = 0; l < W; l++) present |= 1u << cell[l];
    VI c;
    memcpy(&c, cell, sizeof c);
    if (size == 4) return pick_as<VI>(ring, bytes, mask, c, present, count, out);
    return pick_as<VL>(ring, bytes, mask, c, present, count, out);
  }
  for (i64 k = 0; k < count; k++)
    for (int l = 0; l < W; l++) memcpy(out + (k * W + l) * size, ring + cell[l] * bytes + (k * W + l) * size, size);
}
template <class V> INLINE void blend(char *to, const char *from, i64 count, VB where) {
  for (i64 k = 0; k < count; k++) st(to, k, sel(where, ld<V>(from, k), ld<V>(to, k)));
}
static void blend_bytes(char *to, const char *from, i64 count, i64 size, const i32 *where) {
  for (i64 k = 0; k < count; k++)
    for (int l = 0; l < W; l++)
      if (where[l]) memcpy(to + (k * W + l) * size, from + (k * W + l) * size, size);
}
static void blend_sized(char *to, const char *from, i64 count, i64 size, const i32 *where) {
  VB m;
  memcpy(&m.m, where, sizeof m.m);
  if (size == 4) blend<VI>(to, from, count, m);
  else if (size == 8) blend<VL>(to, from, count, m);
  else blend_bytes(to, from, count, size, where);
}
// Write outputs of steps `seq` (-1: none) into their cells.
static void write(Block &b, const NodeInfo &n, const i32 *seq, const char *value) {
  const i64 bytes = n.count * n.size * W;
  char *ring = b.moving + n.ring;
  if (b.uniform) {
    memcpy(ring + (seq[0] & n.ring_mask) * bytes, value, bytes);
    return;
  }
  for (i32 q = 0; q <= n.ring_mask; q++) {
    i32 where[W];
    bool some = false, all = true;
    for (int l = 0; l < W; l++) {
      const bool here = seq[l] >= 0 && (seq[l] & n.ring_mask) == q;
      where[l] = -here;
      some |= here;
      all &= here;
    }
    if (all) memcpy(ring + q * bytes, value, bytes);
    else if (some) blend_sized(ring + q * bytes, value, n.count, n.size, where);
  }
}

// Times of a message [s]; minus infinity of an initial output.
INLINE void times_of(const Model &m, const EdgeInfo &e, i64 row, i32 message, double &sent, double &received) {
  sent = received = -__builtin_inf();
  if (message < 0) return;
  const i64 step = row * m.step_columns + m.node[e.sender].step_base + message;
  if (e.flags & 2) sent = seconds(m.t_end[step], m);
  if (e.flags & 4) received = seconds(m.t_received[row * m.message_columns + e.message_base + message], m);
}

// Collect what node `n` sees at its step `seq`, the same in all lanes; return the number of messages.
static int look_together(const Block &b, const NodeInfo &n, i32 seq, View &v) {
  const Model &m = *b.m;
  const i64 row = b.row[0];
  int j = 0;
  if (n.flags & 1) v.times[0] = splat<VD>(seconds(m.t_start[row * m.step_columns + n.step_base + seq], m));
  for (const EdgeInfo *e = m.edge + n.first_edge; e < m.edge + n.first_edge + n.edges; e++) {
    const NodeInfo &s = m.node[e->sender];
    const i32 *messages = m.windows + row * m.window_columns + e->window_base + i64(seq) * e->window;
    for (i32 i = 0; i < e->window; i++, j++) {
      v.data[j] = b.moving + s.ring + (messages[i] & s.ring_mask) * s.count * s.size * W;
      if (!e->flags) continue;
      double sent, received;
      times_of(m, *e, row, messages[i], sent, received);
      v.seq[j] = splat<VL>(i64(messages[i]));
      v.times[1 + j] = splat<VD>(sent);
      v.times[1 + PLACES + j] = splat<VD>(received);
    }
  }
  return j;
}

// Collect what node `n` sees at the steps `seq` of the lanes.
static void look(const Block &b, const NodeInfo &n, const i32 *seq, View &v) {
  if (b.uniform) {
    look_together(b, n, seq[0], v);
    return;
  }
  const Model &m = *b.m;
  char *stage = v.stage;
  int j = 0;
  if (n.flags & 1)
    for (int l = 0; l < W; l++)
      put(v.times[0], l, seconds(m.t_start[b.row[l] * m.step_columns + n.step_base + seq[l]], m));
  for (const EdgeInfo *e = m.edge + n.first_edge; e < m.edge + n.first_edge + n.edges; e++) {
    const NodeInfo &s = m.node[e->sender];
    const i64 bytes = s.count * s.size * W;
    const char *ring = b.moving + s.ring;
    for (i32 i = 0; i < e->window; i++, j++) {
      i32 message[W], cell[W], differ = 0;
      const i32 *const *seen = b.seen;
      const i64 at = e->window_base + i;
      const i32 window = e->window;
#pragma GCC unroll 1
      for (int l = 0; l < W; l++) message[l] = seen[l][at + i64(seq[l] * window)];
      for (int l = 0; l < W; l++) cell[l] = message[l] & s.ring_mask;
      for (int l = 0; l < W; l++) differ |= cell[l] ^ cell[0];
      v.data[j] = ring + cell[0] * bytes;
      if (differ) {
        pick(ring, bytes, s.ring_mask, cell, s.count, s.size, stage);
        v.data[j] = stage;
        stage += bytes;
      }
      for (int l = 0; l < W && e->flags; l++) {
        double sent, received;
        times_of(m, *e, b.row[l], message[l], sent, received);
        put(v.seq[j], l, message[l]);
        put(v.times[1 + j], l, sent);
        put(v.times[1 + PLACES + j], l, received);
      }
    }
  }
}

// Run a step of a node in the blocks that wait for it.
static void run_bodies(int index, Call &c, i64 count, const char *K) {
  if (count > 1 && SIDE > 1 && MIXED[index]) {
    c.count = count;
    for (i64 k = count; k < SIDE; k++) c.repeat(k); // everything is read before anything is written
    MIXED[index](c, K);
    return;
  }
  for (i64 k = 0; k < count; k++)
    BODIES[index](c.P[k], c.H[k], c.S[k], c.X[k], c.Q[k], c.T[k], c.A[k], c.S2[k], c.Y[k], K);
}

// All lanes of some blocks run step `seq` of a node: nothing is masked or copied, and one search does for all blocks.
APART void run_together(Block *blocks, i64 count, int index, i32 seq, const char *H, View &v) {
  const Model &m = *blocks->m;
  const NodeInfo &n = m.node[index];
  const i64 output = n.ring + (seq & n.ring_mask) * n.count * n.size * W, bytes = (8 * n.n8 + 4 * n.n4 + n.n1) * W;
  const int places = look_together(*blocks, n, seq, v);
  Call c;
  const char *X[SIDE][PLACES];
  char staged[SIDE][STATE * W];
  for (i64 first = 0; first < count; first += SIDE) {
    const i64 some = count - first < SIDE ? count - first : SIDE;
    for (i64 k = 0; k < some; k++) {
      const Block &b = blocks[first + k];
      for (int j = 0; j < places; j++) X[k][j] = v.data[j] + (b.moving - blocks->moving);
      char *state = b.moving + n.state;
      c.set(k, b.fixed, H + (first + k) * HOISTED * W, state, X[k], v, n.flags & 2 ? staged[k] : state,
            b.moving + output);
    }
    run_bodies(index, c, some, m.constants);
    for (i64 k = 0; k < some && n.flags & 2; k++) memcpy(blocks[first + k].moving + n.state, staged[k], bytes);
  }
}

// A step of a node in a block whose lanes run different steps, or none (-1): these keep what they had.
struct Turn {
  Block *b;
  i32 seq[W];
  bool all, in_place; // whether all lanes run; whether the new state is written over the old one at once
  char *to_output;
  View v;
  char state[STATE * W], output[OUTPUT * W];

  void begin(int index, const char *H, Call &c, i64 k) {
    const NodeInfo &n = b->m->node[index];
    bool same = true;
    i32 some = 0, place[W];
    all = true;
    for (int l = 0; l < W; l++) some = seq[l] > some ? seq[l] : some;
    for (int l = 0; l < W; l++) {
      all &= seq[l] >= 0;
      same &= seq[l] == seq[0];
      place[l] = seq[l] >= 0 ? seq[l] : some; // the others look where these do; it is not used
    }
    look(*b, n, place, v);
    in_place = all && !(n.flags & 2);
    to_output = all && same ? b->moving + n.ring + (seq[0] & n.ring_mask) * n.count * n.size * W : output;
    c.set(k, b->fixed, H, b->moving + n.state, v.data, v, in_place ? b->moving + n.state : state, to_output);
  }
  void end(int index) {
    const NodeInfo &n = b->m->node[index];
    char *old = b->moving + n.state;
    const i64 four = 8 * n.n8 * W, one = four + 4 * n.n4 * W;
    if (!in_place && all) memcpy(old, state, one + n.n1 * W);
    else if (!all) {
      i32 runs[W];
      for (int l = 0; l < W; l++) runs[l] = -(seq[l] >= 0);
      blend_sized(old, state, n.n8, 8, runs);
      blend_sized(old + four, state + four, n.n4, 4, runs);
      if (n.n1) blend_bytes(old + one, state + one, n.n1, 1, runs);
    }
    if (to_output == output) write(*b, n, seq, output);
  }
};

// The steps that a slot runs in the lanes of a block, -1 for none; returns whether any lane runs.
INLINE bool steps_of(const Block &b, i64 slot, i32 *seq) {
  const Model &m = *b.m;
  if (b.uniform) {
    const i32 one = seq_at(m, b.row[0], b.step[0], slot);
    for (int l = 0; l < W; l++) seq[l] = one;
    return one >= 0;
  }
  i32 own[W], all = -1;
  if (m.small_table) {
#pragma GCC unroll 1
    for (int l = 0; l < W; l++) own[l] = ((const int16_t *)b.runs[l])[slot];
  } else {
#pragma GCC unroll 1
    for (int l = 0; l < W; l++) own[l] = ((const i32 *)b.runs[l])[slot];
  }
  for (int l = 0; l < W; l++) all &= own[l]; // negative if all are
  memcpy(seq, own, sizeof own);
  return all >= 0;
}

// A slot of blocks that are at different steps or have different schedules.
APART void run_apart(Block *blocks, i64 count, i64 slot, const char *H) {
  const Model &m = *blocks->m;
  const i32 index = m.slot[slot];
  Turn turns[SIDE];
  Call c;
  i64 waiting = 0;
  const auto run = [&] {
    run_bodies(index, c, waiting, m.constants);
    for (i64 k = 0; k < waiting; k++) turns[k].end(index);
    waiting = 0;
  };
  for (i64 k = 0; k < count; k++) {
    Block &b = blocks[k];
    Turn &turn = turns[waiting];
    if (!steps_of(b, slot, turn.seq)) continue;
    turn.b = &b;
    turn.begin(index, H + k * HOISTED * W, c, waiting++);
    if (waiting == SIDE) run();
  }
  if (waiting) run();
}

// What the supervisor reads at the step at which each lane of up to SIDE blocks is.
APART void observe(Block *blocks, i64 count, const char *H, const char *const *action) {
  const Model &m = *blocks->m;
  const NodeInfo &n = m.node[m.supervisor];
  View views[SIDE];
  Call c;
  char new_state[SIDE][STATE * W];
  for (i64 k = 0; k < count; k++) {
    const Block &b = blocks[k];
    char *state = b.moving + n.state;
    look(b, n, b.step, views[k]);
    c.set(k, b.fixed, H + k * HOISTED * W, state, views[k].data, views[k], n.flags & 2 ? new_state[k] : state,
          b.moving + m.readings, action[k]);
  }
  run_bodies(i32(m.supervisor), c, count, m.constants);
  for (i64 k = 0; k < count && n.flags & 2; k++)
    memcpy(blocks[k].moving + n.state, new_state[k], (8 * n.n8 + 4 * n.n4 + n.n1) * W);
}

// Everything before the supervisor step at which each lane is, then what the supervisor reads there.
static void run_slots(Block *blocks, i64 count, bool together, const char *H, const char *const *action, View &v,
                      bool observes) {
  const Model &m = *blocks->m;
  for (i64 s = 0; s < m.slots; s++) {
    if (!together) {
      run_apart(blocks, count, s, H);
      continue;
    }
    const i32 seq = seq_at(m, blocks->row[0], blocks->step[0], s);
    if (seq >= 0) run_together(blocks, count, m.slot[s], seq, H, v);
  }
  for (i64 k = 0; k < count && OBSERVES && observes; k += SIDE)
    observe(blocks + k, count - k < SIDE ? count - k : SIDE, H + k * HOISTED * W, action + k);
}

static Block open_block(const Model &m, const char *fixed, char *moving) {
  Block b{&m, fixed, moving, {}, {}, {}, {}, {}, true, true};
  memcpy(b.environment, fixed, sizeof b.environment);
  memcpy(b.row, fixed + 4 * W, sizeof b.row);
  memcpy(b.step, moving, sizeof b.step);
  for (int l = 1; l < W; l++) {
    b.level &= b.step[l] == b.step[0];
    b.uniform &= b.row[l] == b.row[0];
  }
  b.uniform &= b.level;
  const i64 size = m.small_table ? 2 : 4;
  for (int l = 0; l < W && !b.uniform; l++) {
    b.runs[l] = (const char *)m.table + (b.row[l] * (m.steps + 1) + b.step[l]) * m.slots * size;
    b.seen[l] = m.windows + b.row[l] * m.window_columns;
  }
  return b;
}
static void gather(const i32 *environment, const char *from, i64 stride, i64 count, i64 size, char *to) {
  for (int l = 0; l < W; l++) {
    const char *own = from + (environment[l] < 0 ? environment[0] : environment[l]) * stride;
    for (i64 k = 0; k < count; k++) memcpy(to + (k * W + l) * size, own + k * size, size);
  }
}
template <int SIZE> static void scatter_as(const i32 *environment, const char *from, i64 count, char *to) {
  for (int l = 0; l < W; l++) {
    if (environment[l] < 0) continue;
    char *own = to + environment[l] * count * SIZE;
    for (i64 k = 0; k < count; k++) memcpy(own + k * SIZE, from + (k * W + l) * SIZE, SIZE);
  }
}
static void scatter(const i32 *environment, const char *from, i64 count, i64 size, char *to) {
  if (size == 4) scatter_as<4>(environment, from, count, to);
  else if (size == 8) scatter_as<8>(environment, from, count, to);
  else scatter_as<1>(environment, from, count, to);
}

// Returns the first environment that has fewer than `steps` steps left, or -1.
static i64 short_of_steps(const Model &m, const char *fixed, const char *moving, i64 first, i64 last, i64 steps) {
  i64 found = -1;
  for (i64 block = first; block < last; block++) {
    i32 step[W], environment[W];
    memcpy(step, moving + block * m.moving_bytes, sizeof step);
    memcpy(environment, fixed + block * m.fixed_bytes, sizeof environment);
    for (int l = 0; l < W; l++)
      if (environment[l] >= 0 && step[l] + steps > m.steps && (found < 0 || environment[l] < found))
        found = environment[l];
  }
  return found;
}

INLINE void copy(char *to, const char *from, i64 bytes) {
  i64 at = 0;
  for (; at + 64 <= bytes; at += 64) memcpy(to + at, from + at, 64);
  if (at < bytes) memcpy(to + at, from + at, bytes - at);
}

// What a policy is shown of a block beside the readings.
INLINE void show(const Block &b, const Rollout &r, i64 t, char *G) {
  for (i64 k = 0; k < r.signals; k++)
    gather(b.environment, r.signal_from[k] + t * r.signal_time[k], r.signal_environment[k], r.signal_count[k],
           r.signal_size[k], G + r.signal_offset[k] * W);
}

// Actions of a policy.
static void decide(Block *blocks, i64 count, const Rollout &r, i64 t, View &v, char *signals, char *actions) {
  const Model &m = *blocks->m;
  const i64 each = r.signal_bytes * W;
  i64 k = 0;
  for (; r.policies && count - k >= 4; k += 4) {
    const char *R[4], *G[4];
    char *Y[4];
    for (i64 j = 0; j < 4; j++) {
      show(blocks[k + j], r, t, signals + (k + j) * each);
      R[j] = blocks[k + j].moving + m.readings, G[j] = signals + (k + j) * each, Y[j] = actions + (k + j) * ACTION * W;
    }
    r.policies(r.weights, R, G, Y);
  }
  for (; k < count; k++) {
    const Block &b = blocks[k];
    if (r.looks) look(b, m.node[m.supervisor], b.step, v);
    show(b, r, t, signals + k * each);
    r.policy(r.weights, b.moving + m.readings, v.data, v.seq, v.times, signals + k * each, actions + k * ACTION * W);
  }
}

INLINE void step_on(Block &b) {
  if (b.uniform) {
    b.step[0]++; // the others are set at the end
    return;
  }
  const i64 bytes = b.m->slots * (b.m->small_table ? 2 : 4);
  for (int l = 0; l < W; l++) b.step[l]++;
  for (int l = 0; l < W; l++) b.runs[l] += bytes;
}

// Take blocks through all steps of a call, step by step: while one waits for its last result, the processor works on
// the next. `together`: all are at the same step of the same schedule.
static void run_blocks(Block *blocks, i64 count, bool together, const Rollout &r) {
  const Model &m = *blocks->m;
  const NodeInfo &n = m.node[m.supervisor];
  const i64 bytes = n.count * n.size;
  // Readings that nobody sees and that leave nothing behind are worked out at the last step only.
  const bool seen = r.policy || r.outputs || n.n8 || n.n4 || n.n1;
  View v;
  char H[GROUP * HOISTED * W], buffer[GROUP * ACTION * W];
  const char *action[GROUP];
  char *G = (char *)__builtin_alloca(GROUP * r.signal_bytes * W);
  for (i64 k = 0; k < count; k++) prologue(blocks[k].fixed, H + k * HOISTED * W);
  for (i64 t = 0; t < r.steps; t++) {
    if (r.policy) decide(blocks, count, r, t, v, G, buffer);
    for (i64 k = 0; k < count; k++) {
      Block &b = blocks[k];
      char *own = buffer + k * ACTION * W;
      if (!r.policy) {
        if (b.uniform) own = b.moving + n.ring + (b.step[0] & n.ring_mask) * bytes * W; // where it belongs
        if (k && !r.action_environment) copy(own, action[0], bytes * W); // one action for all
        else gather(b.environment, r.actions + t * r.action_time, r.action_environment, n.count, n.size, own);
      }
      if (r.out_actions) scatter(b.environment, own, n.count, n.size, r.out_actions + t * m.batch * bytes);
      if (r.policy || !b.uniform) write(b, n, b.step, own);
      step_on(b);
      action[k] = own;
    }
    run_slots(blocks, count, together, H, action, v, seen || t == r.steps - 1);
    for (i64 k = 0; k < count; k++)
      for (i64 o = 0; o < r.outputs; o++)
        scatter(blocks[k].environment, blocks[k].moving + m.readings + r.reading_offset[o] * W, r.reading_count[o],
                r.reading_size[o], r.out_readings[o] + t * m.batch * r.reading_count[o] * r.reading_size[o]);
  }
  for (i64 k = 0; k < count; k++) {
    Block &b = blocks[k];
    for (int l = 0; l < W && b.uniform; l++) b.step[l] = b.step[0]; // only one was counted
    memcpy(b.moving, b.step, sizeof b.step);
  }
}

extern "C" i64 rollout(const Model *model, const char *fixed, const char *from, char *to, const Rollout *call) {
  const Model &m = *model;
  const Rollout &r = *call;
  const i64 spent = short_of_steps(m, fixed, from, r.first, r.last, r.steps);
  if (spent >= 0) return spent;
  Block same[GROUP], rest[GROUP]; // waiting: at the same step of the same schedule, and others
  i64 alike = 0, others = 0;
  const auto put_aside = [&](const Block &b) {
    rest[others++] = b;
    if (others == GROUP) run_blocks(rest, others, false, r), others = 0;
  };
  const auto run_alike = [&] {
    const i64 full = alike - alike % SIDE; // what is left over fills up the others
    if (full) run_blocks(same, full, true, r);
    for (i64 k = full; k < alike; k++) put_aside(same[k]);
    alike = 0;
  };
  for (i64 block = r.first; block < r.last; block++) {
    char *moving = to + block * m.moving_bytes;
    if (to != from) memcpy(moving, from + block * m.moving_bytes, m.moving_bytes);
    const Block b = open_block(m, fixed + block * m.fixed_bytes, moving);
    if (!b.uniform) {
      put_aside(b);
      continue;
    }
    if (alike && (b.row[0] != same[0].row[0] || b.step[0] != same[0].step[0] || alike == GROUP)) run_alike();
    same[alike++] = b;
  }
  run_alike();
  if (others) run_blocks(rest, others, others == 1 && rest[0].uniform, r);
  return -1;
}

extern "C" i64 step(const Model *m, const char *fixed, const char *from, char *to, const char *action) {
  const NodeInfo &n = m->node[m->supervisor];
  Rollout r{};
  r.steps = 1;
  r.last = m->blocks;
  r.actions = action;
  r.action_environment = n.count * n.size;
  return rollout(m, fixed, from, to, &r);
}

// Run up to the first step of the supervisor.
extern "C" void start(const Model *model, const char *fixed, char *moving) {
  const Model &m = *model;
  View v;
  char H[HOISTED * W];
  for (i64 block = 0; block < m.blocks; block++) {
    const char *own = fixed + block * m.fixed_bytes;
    Block b = open_block(m, own, moving + block * m.moving_bytes);
    prologue(own, H);
    const char *action = b.moving + m.node[m.supervisor].ring;
    run_slots(&b, 1, b.uniform, H, &action, v, true);
  }
}
